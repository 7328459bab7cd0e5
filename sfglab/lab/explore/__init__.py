"""Exploring in a notebook: sliders change parameters, and a figure follows."""

from __future__ import annotations

from sfglab.lab.explore.interactive import Interactive, explore
from sfglab.lab.explore.press import Automaton, Parts, Pressed, part, transition_part
from sfglab.lab.pictures import Axis, Panel, Picture, Series

__all__ = [
    "Automaton",
    "Axis",
    "Interactive",
    "Panel",
    "Parts",
    "Picture",
    "Pressed",
    "Series",
    "explore",
    "part",
    "transition_part",
]
