"""Exploring an experiment in a notebook: turn a field of its configuration, see the figure follow.

Knows experiments, their looks and widgets; refuses to know what any of them is about.
"""

from __future__ import annotations

from sfglab.lab.explore.explorer import Explorer, explore
from sfglab.lab.explore.press import Pressed, part

__all__ = ["Explorer", "Pressed", "explore", "part"]
