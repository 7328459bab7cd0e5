"""One robot's part in Fig. 15: the values of its LIDAR, its commands, and its localisation at the station.

Cores only: values in, values out. Sensing publishes the last value of each beam, and actuation executes the last
command. The simulated shell and the live one do that.

The LIDAR is a SLAMTEC RPLIDAR A2M8 (section 3.1), as its data sheet has it: eight beams, 10 turns a second,
range 0.15 to 12 m, resolution 0.5 mm, and 1 % of the distance beyond 1.5 m. The steps are why a beam along a
straight wall repeats its value. A range travels as float metres; its number here is the step's, which is what
the reliability model compares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfglab.arp.hallway.course import HALF_WIDTH_M

BEAMS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)
"""Directions, counter-clockwise from ahead: paper B, section 3.2."""

SCAN_HZ = 10  #: Turns a second, and new values of one beam.

NO_ECHO = 0  #: Step of a range that the sensor does not see.

_NEAREST_M, _FARTHEST_M = 0.15, 12.0
_FINE_M, _FINE_UNTIL_M = 0.0005, 1.5
_COARSE = math.log1p(0.01)
_FINE_STEPS = round(_FINE_UNTIL_M / _FINE_M)


def step_from_range(range_m: float) -> int:
    """Return the number of the step that a range is measured as; `NO_ECHO` out of the sensor's reach."""
    if not _NEAREST_M <= range_m <= _FARTHEST_M:
        return NO_ECHO
    if range_m <= _FINE_UNTIL_M:
        return round(range_m / _FINE_M)
    return _FINE_STEPS + round(math.log(range_m / _FINE_UNTIL_M) / _COARSE)


def range_from_step(step: int) -> float:
    """Return the range that a step stands for, metres; infinity for `NO_ECHO`."""
    if step == NO_ECHO:
        return math.inf
    if step <= _FINE_STEPS:
        return step * _FINE_M
    return _FINE_UNTIL_M * math.exp((step - _FINE_STEPS) * _COARSE)


SPEED_M_S = 0.22  #: The constant velocity: the highest of a TurtleBot3 Burger.

SAFE_M = 0.21
"""A beam ahead that is shorter is an obstacle: 0.2 m, and 0.01 m for the LIDAR's error, as in ROBOTIS' own
example of an obstacle detection (turtlebot3_example)."""

_STRAIGHT_M = 0.05  # by which three beams of one side may miss a common straight wall
_MRAD = 1000.0
_TURN_OFFSET = 1 << 14


@dataclass(frozen=True, slots=True)
class Command:
    """Command to a robot: to move or not, and how fast to turn."""

    moving: bool  #: At the constant velocity, or not at all.
    turn_mrad_s: int = 0  #: Milliradians a second, to the left.

    @property
    def speed_m_s(self) -> float:
        """Velocity ahead."""
        return SPEED_M_S if self.moving else 0.0

    @property
    def turn_rad_s(self) -> float:
        """Turning velocity, to the left."""
        return self.turn_mrad_s / _MRAD

    @property
    def number(self) -> int:
        """A number of its own for each command: what the reliability model carries."""
        return (self.moving << 15) | (self.turn_mrad_s + _TURN_OFFSET)

    @classmethod
    def from_number(cls, number: int) -> Command:
        """Return the command of a number."""
        return cls(bool(number >> 15), (number & 0x7FFF) - _TURN_OFFSET)

    @classmethod
    def from_velocities(cls, speed_m_s: float, turn_rad_s: float) -> Command:
        """Return the command that velocities, as a Twist has them, stand for."""
        return cls(speed_m_s > 0.0, round(turn_rad_s * _MRAD))


STOP = Command(moving=False)


@dataclass(frozen=True, slots=True)
class View:
    """Where a robot is, seen from its own beams."""

    ahead_m: float  #: Range ahead.
    left_m: float  #: Range 45 degrees to the left of ahead.
    right_m: float  #: The same to the right.
    beside_left_m: float  #: Range to the left.
    beside_right_m: float  #: Range to the right.
    #: Heading to the left wall, from that wall; None where it is not straight.
    heading_left_rad: float | None
    #: The same (positive is still to the left) from the wall on the right.
    heading_right_rad: float | None
    #: Distance to the left of the middle, from the straight walls; None without any.
    offset_m: float | None
    obstacle: bool  #: Whether something ahead is closer than is safe.

    @property
    def heading_rad(self) -> float | None:
        """Heading to the left of the corridor's, the mean of what both walls say."""
        known = [h for h in (self.heading_left_rad, self.heading_right_rad) if h is not None]
        return sum(known) / len(known) if known else None


class LocalisationNode:
    """At the station: a robot's place in its hallway, from the last value of each of its beams."""

    def __init__(self) -> None:
        self._steps: list[int | None] = [None] * len(BEAMS_DEG)
        #: Last range of each beam that is known here.
        self.ranges_m = [math.inf] * len(BEAMS_DEG)
        self.view: View | None = None

    def hear(self, beam: int, step: int) -> bool:
        """Take the value of a beam, by its index in `BEAMS_DEG`; return whether anything is different now."""
        if self._steps[beam] == step:
            return False
        self._steps[beam] = step
        self.ranges_m[beam] = range_from_step(step)
        if None in self._steps:
            return False
        self.view = _view(self.ranges_m)
        return True


def _view(ranges: list[float]) -> View:
    ahead, left, beside_left, behind_left, _, behind_right, beside_right, right = ranges
    wall_left = _wall(left, beside_left, behind_left)
    wall_right = _wall(right, beside_right, behind_right)
    offsets = [HALF_WIDTH_M - wall_left[1]] if wall_left else []
    offsets += [wall_right[1] - HALF_WIDTH_M] if wall_right else []
    return View(
        ahead_m=ahead,
        left_m=left,
        right_m=right,
        beside_left_m=beside_left,
        beside_right_m=beside_right,
        heading_left_rad=wall_left[0] if wall_left else None,
        heading_right_rad=-wall_right[0] if wall_right else None,
        offset_m=sum(offsets) / len(offsets) if offsets else None,
        obstacle=min(ahead, left, right) < SAFE_M,
    )


def _wall(front_m: float, beside_m: float, behind_m: float) -> tuple[float, float] | None:
    """Return the heading relative to a side's wall and the distance from it; None if no line fits."""
    if math.inf in (front_m, beside_m, behind_m):
        return None
    heading = math.atan2(behind_m - front_m, behind_m + front_m)
    distance = front_m * behind_m / math.hypot(front_m, behind_m)
    return (
        (heading, distance) if abs(beside_m * math.cos(heading) - distance) <= _STRAIGHT_M else None
    )
