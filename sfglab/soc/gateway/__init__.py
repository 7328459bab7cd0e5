"""The gateway between a software-mapped and a hardware-mapped topic (paper C, section 3).

Bottom up: `core` (the core's table), `world` (a moment of it and what surrounds it), `steps` (what can happen
next), `explore` (every interleaving); `drawing` draws the table.
"""

from __future__ import annotations

from sfglab.soc.gateway.core import (
    TABLE,
    Core,
    Drive,
    IllegalInputError,
    Input,
    Latch,
    Move,
    Row,
    State,
    Table,
    filtered,
)
from sfglab.soc.gateway.explore import ExplorationLimitError, explore
from sfglab.soc.gateway.world import Bound

__all__ = [
    "TABLE",
    "Bound",
    "Core",
    "Drive",
    "ExplorationLimitError",
    "IllegalInputError",
    "Input",
    "Latch",
    "Move",
    "Row",
    "State",
    "Table",
    "explore",
    "filtered",
]
