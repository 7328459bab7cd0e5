"""The package `hallway` has paper B, section 3.2: three robots drive around a hallway with commands from a station.

The modules build on each other. `course` has walls and compiled geometry, and `nodes` has the nodes of a robot.
`station` decides the motion, and `world` has physics and verdict. `simulation` drives a whole lap over the reliability
model.
Users import `simulation` by its own name, because `simulation` loads the reliability model. Decisions are pure
functions; `sfglab.lab.workers.hallway` runs the same nodes live.
"""

from __future__ import annotations

from sfglab.arp.hallway.course import (
    AREAS,
    HALF_WIDTH_M,
    HOME,
    ROBOTS,
    WAYPOINTS,
    Area,
)
from sfglab.arp.hallway.nodes import (
    BEAMS_DEG,
    SCAN_HZ,
    STOP,
    Command,
    range_from_step,
    step_from_range,
)
from sfglab.arp.hallway.station import Manoeuvre, Station
from sfglab.arp.hallway.world import (
    LIMIT_S,
    RADIUS_M,
    SCAN_STEPS,
    STEP_NS,
    End,
    Verdict,
    World,
    judge,
)

__all__ = [
    "AREAS",
    "BEAMS_DEG",
    "HALF_WIDTH_M",
    "HOME",
    "LIMIT_S",
    "RADIUS_M",
    "ROBOTS",
    "SCAN_HZ",
    "SCAN_STEPS",
    "STEP_NS",
    "STOP",
    "WAYPOINTS",
    "Area",
    "Command",
    "End",
    "Manoeuvre",
    "Station",
    "Verdict",
    "World",
    "judge",
    "range_from_step",
    "step_from_range",
]
