"""Exploring an experiment in a notebook: turn a field of its configuration, see the figure follow."""

from __future__ import annotations

from sfglab.lab.explore.explorer import Explorer, explore
from sfglab.lab.explore.press import Automaton, Moment, Parts, Pressed, part, transition_part

__all__ = [
    "Automaton",
    "Explorer",
    "Moment",
    "Parts",
    "Pressed",
    "explore",
    "part",
    "transition_part",
]
