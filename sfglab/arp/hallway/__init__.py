"""Paper B, section 3.2: three robots go around a hallway on what their messages tell.

Bottom up: `course` (walls), `lidar` (steps of ranges), `rays` (compiled geometry), `nodes` (sensing,
localisation and actuation of a robot), `planning` and `station` (what the station decides), `world` (physics),
`verdict`.
Decisions are pure; whoever carries the messages between them, simulated or live, is elsewhere.
"""

from __future__ import annotations

from sfglab.arp.hallway.course import AREAS, HALF_WIDTH_M, HOME, WAYPOINTS, Area, Box, course_length_m
from sfglab.arp.hallway.lidar import BEAMS_DEG, NO_ECHO, SCAN_HZ, range_from_step, step_from_range
from sfglab.arp.hallway.nodes import (
    SAFE_M,
    SPEED_M_S,
    STOP,
    ActuationNode,
    Command,
    LocalisationNode,
    SensingNode,
    View,
)
from sfglab.arp.hallway.planning import TRANSITIONS, Manoeuvre, PlanningNode, Sight, command_for
from sfglab.arp.hallway.station import LEADER, Station
from sfglab.arp.hallway.verdict import LIMIT_S, End, Verdict, judge
from sfglab.arp.hallway.world import RADIUS_M, STEP_NS, World

__all__ = [
    "AREAS",
    "BEAMS_DEG",
    "HALF_WIDTH_M",
    "HOME",
    "LEADER",
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
    "Box",
    "Command",
    "End",
    "LocalisationNode",
    "Manoeuvre",
    "PlanningNode",
    "SensingNode",
    "Sight",
    "Station",
    "Verdict",
    "View",
    "World",
    "command_for",
    "course_length_m",
    "judge",
    "range_from_step",
    "step_from_range",
]
