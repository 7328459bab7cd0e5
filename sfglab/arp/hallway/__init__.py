"""Paper B, section 3.2: three robots go around a hallway on what their messages tell.

Bottom up: `course` (walls and compiled geometry), `nodes` (a robot's), `station` (what the station decides),
`world` (physics and verdict). Decisions are pure; whoever carries the messages between them, simulated or live,
is elsewhere.
"""

from __future__ import annotations

from sfglab.arp.hallway.course import AREAS, HALF_WIDTH_M, HOME, WAYPOINTS, Area, course_length_m
from sfglab.arp.hallway.nodes import (
    BEAMS_DEG,
    NO_ECHO,
    SAFE_M,
    SCAN_HZ,
    SPEED_M_S,
    STOP,
    ActuationNode,
    Command,
    LocalisationNode,
    SensingNode,
    range_from_step,
    step_from_range,
)
from sfglab.arp.hallway.station import TRANSITIONS, Manoeuvre, PlanningNode, Sight, Station, command_for
from sfglab.arp.hallway.world import LIMIT_S, RADIUS_M, STEP_NS, End, Verdict, World, judge

__all__ = [
    "AREAS",
    "BEAMS_DEG",
    "HALF_WIDTH_M",
    "HOME",
    "LIMIT_S",
    "NO_ECHO",
    "RADIUS_M",
    "SAFE_M",
    "SCAN_HZ",
    "SPEED_M_S",
    "STEP_NS",
    "STOP",
    "TRANSITIONS",
    "WAYPOINTS",
    "ActuationNode",
    "Area",
    "Command",
    "End",
    "LocalisationNode",
    "Manoeuvre",
    "PlanningNode",
    "SensingNode",
    "Sight",
    "Station",
    "Verdict",
    "World",
    "command_for",
    "course_length_m",
    "judge",
    "range_from_step",
    "step_from_range",
]
