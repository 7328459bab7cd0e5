"""The module `nodes` has one robot's part of Fig. 15: LIDAR values, commands, and localisation at the station.

The module has only cores of nodes, without I/O. Sensing publishes the last value of each beam, and actuation
executes the last command. The shell of the simulation and the shell of the live lap call the cores.

The LIDAR is a SLAMTEC RPLIDAR A2M8 (section 3.1) with the values of its data sheet: eight beams, 10 turns per second,
range 0.15 to 12 m, resolution 0.5 mm, and 1 % of the distance beyond 1.5 m. Because of the steps of its resolution, a
beam along a straight wall repeats its value. A range travels as float metres; the number of the range is the number of
its step, and the reliability model compares the numbers of ranges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfglab.arp.hallway.course import HALF_WIDTH_M

BEAMS_DEG = (0, 45, 90, 135, 180, 225, 270, 315)
"""Directions of the beams, counter-clockwise from ahead: paper B, section 3.2."""

SCAN_HZ = 10  #: Turns of the LIDAR per second, and new values of one beam per second.

NO_ECHO = 0  #: Step of a range that the sensor cannot measure.

_NEAREST_M, _FARTHEST_M = 0.15, 12.0
_FINE_M, _FINE_UNTIL_M = 0.0005, 1.5
_COARSE = math.log1p(0.01)
_FINE_STEPS = round(_FINE_UNTIL_M / _FINE_M)


def step_from_range(range_m: float) -> int:
    """Return the number of the LIDAR's resolution step for a range, metres; `NO_ECHO` out of the LIDAR's reach."""
    if not _NEAREST_M <= range_m <= _FARTHEST_M:
        return NO_ECHO
    if range_m <= _FINE_UNTIL_M:
        return round(range_m / _FINE_M)
    return _FINE_STEPS + round(math.log(range_m / _FINE_UNTIL_M) / _COARSE)


def range_from_step(step: int) -> float:
    """Return the range of a step, metres; infinity for `NO_ECHO`."""
    if step == NO_ECHO:
        return math.inf
    if step <= _FINE_STEPS:
        return step * _FINE_M
    return _FINE_UNTIL_M * math.exp((step - _FINE_STEPS) * _COARSE)


SPEED_M_S = 0.22  #: Constant velocity: the highest velocity of a TurtleBot3 Burger.

SAFE_M = 0.21
"""Largest range ahead that counts as an obstacle: 0.2 m, and 0.01 m for the LIDAR's error, as in ROBOTIS' own
example of an obstacle detection (turtlebot3_example)."""

_STRAIGHT_M = 0.05  # Three beams of one side may deviate this much from a common straight wall.
_MRAD = 1000.0
_TURN_OFFSET = 1 << 14


@dataclass(frozen=True, slots=True)
class Command:
    """A `Command` tells a robot whether to move, and how fast to turn."""

    moving: bool  #: Whether the robot moves with the constant velocity; otherwise the robot stands.
    turn_mrad_s: int = 0  #: Turning velocity, milliradians per second, positive to the left.

    @property
    def speed_m_s(self) -> float:
        """Velocity ahead, m/s."""
        return SPEED_M_S if self.moving else 0.0

    @property
    def turn_rad_s(self) -> float:
        """Turning velocity, rad/s, positive to the left."""
        return self.turn_mrad_s / _MRAD

    @property
    def number(self) -> int:
        """Number of the command, different for each command; the reliability model transmits this number."""
        return (self.moving << 15) | (self.turn_mrad_s + _TURN_OFFSET)

    @classmethod
    def from_number(cls, number: int) -> Command:
        """Return the command with a number."""
        return cls(bool(number >> 15), (number & 0x7FFF) - _TURN_OFFSET)

    @classmethod
    def from_velocities(cls, speed_m_s: float, turn_rad_s: float) -> Command:
        """Return the command for the velocities of a Twist message."""
        return cls(speed_m_s > 0.0, round(turn_rad_s * _MRAD))


STOP = Command(moving=False)


@dataclass(frozen=True, slots=True)
class View:
    """A `View` is the place of a robot, as measured with the robot's own beams."""

    ahead_m: float  #: Range ahead, metres.
    left_m: float  #: Range 45 degrees to the left of ahead, metres.
    right_m: float  #: Range 45 degrees to the right of ahead, metres.
    beside_left_m: float  #: Range to the left, at 90 degrees, metres.
    beside_right_m: float  #: Range to the right, at 90 degrees, metres.
    #: Heading relative to the left wall, radians, positive to the left; None if the left wall is not straight.
    heading_left_rad: float | None
    #: Heading relative to the right wall, radians, positive to the left; None if the right wall is not straight.
    heading_right_rad: float | None
    #: Distance to the left of the corridor's middle, metres, from the straight walls; None without a straight wall.
    offset_m: float | None
    obstacle: bool  #: Whether an object ahead is closer than the safe distance.

    @property
    def heading_rad(self) -> float | None:
        """Heading relative to the corridor, radians, positive to the left: the mean of both walls' values."""
        known = [h for h in (self.heading_left_rad, self.heading_right_rad) if h is not None]
        return sum(known) / len(known) if known else None


class LocalisationNode:
    """A `LocalisationNode` at the station finds a robot's place in its hallway from the last value of each beam."""

    def __init__(self) -> None:
        self._steps: list[int | None] = [None] * len(BEAMS_DEG)
        #: Last range of each beam that the station knows, m.
        self.ranges_m = [math.inf] * len(BEAMS_DEG)
        self.view: View | None = None

    def hear(self, beam: int, step: int) -> bool:
        """Process the new range step of a beam of `BEAMS_DEG`, given by index; return whether the view has changed."""
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
    """Return the heading relative to a side's wall and the distance from the wall; None if no line fits."""
    if math.inf in (front_m, beside_m, behind_m):
        return None
    heading = math.atan2(behind_m - front_m, behind_m + front_m)
    distance = front_m * behind_m / math.hypot(front_m, behind_m)
    return (
        (heading, distance) if abs(beside_m * math.cos(heading) - distance) <= _STRAIGHT_M else None
    )
