"""The module `world` has the physics of three robots in three areas: motors, contacts, LIDARs, and the end of a run.

Each robot is a TurtleBot3 Burger: differential drive, radius 0.105 m, wheels 0.160 m apart, 0.22 m/s at most (ROBOTIS
e-manual). Wheels differ a little and slip a little, and people place the robots by hand, so a seed selects the errors
of wheels and start poses. A run succeeds if the robots complete one lap without contact and without a stop for
an obstacle. The module has no messages and no decisions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.hallway.course import AREAS, HOME, clearances, drive, scan, winding_rad
from sfglab.arp.hallway.nodes import BEAMS_DEG, SCAN_HZ, Command, step_from_range

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

RADIUS_M = 0.105  #: Radius of the robot's body, metres; a wall at a smaller distance is a contact.

#: Duration of one step: the controller board sets the motors 50 times per second.
STEP_NS = 20_000_000
SCAN_STEPS = round(1e9 / SCAN_HZ / STEP_NS)  #: Number of steps in one turn of the LIDARs.

_BASE_M = 0.160
_WHEEL_SIGMA = 0.005  # The wheels of one robot differ because of tyres and wear.
_SLIP_SIGMA = 0.05  # The slip is a share of one step's way; over a metre it adds up to 3 mm.
_PUT_SIGMA_M, _PUT_SIGMA_RAD = 0.01, math.radians(1.0)
_ANGLES = np.radians(BEAMS_DEG)


class World:
    """A `World` is the physics of one run, one area per robot; the seed selects start poses, wheels and slip."""

    def __init__(self, *, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        robots = len(AREAS)
        self._walls = np.array([area.segments for area in AREAS])
        put = self._random.normal(size=(robots, 3)) * (_PUT_SIGMA_M, _PUT_SIGMA_M, _PUT_SIGMA_RAD)
        #: Pose of each robot: x, y (metres) and heading (radians), shape (robots, 3).
        self.poses: NDArray[np.float64] = np.array(HOME) + put
        #: Speed of each wheel as a share of the commanded speed, shape (robots, 2).
        self._scale = 1.0 + self._random.normal(size=(robots, 2)) * _WHEEL_SIGMA
        #: Distance from each robot's middle to the nearest wall, metres, shape (robots,).
        self.clearance_m = np.empty(robots)
        self._ranges = np.empty(len(_ANGLES))
        self._wound = [winding_rad(x, y) for x, y, _ in self.poses.tolist()]
        clearances(self._walls, self.poses, self.clearance_m)

    def step(self, commands: Sequence[Command]) -> None:
        """Execute the command of each robot for `STEP_NS`."""
        speeds = np.array([(c.speed_m_s, c.turn_rad_s * _BASE_M / 2) for c in commands])
        wheels = speeds[:, :1] + speeds[:, 1:] * (-1.0, 1.0)  # left and right
        slips = self._random.normal(size=self._scale.shape) * _SLIP_SIGMA
        drive(self.poses, wheels * (self._scale + slips), _BASE_M, STEP_NS / 1e9)
        clearances(self._walls, self.poses, self.clearance_m)

    def scan(self, robot: int) -> list[int]:
        """Return the measurement of a robot's LIDAR: one step per direction of `BEAMS_DEG`."""
        scan(self._walls[robot], self.poses[robot], _ANGLES, self._ranges)
        return [step_from_range(range_m) for range_m in self._ranges.tolist()]

    def wound_rad(self) -> list[float]:
        """Return the angle that each robot has driven around the ring since the start, radians.

        The method adds the changes between calls, so callers must call it at least four times per lap.
        """
        for robot, (x, y, _) in enumerate(self.poses.tolist()):
            self._wound[robot] += math.remainder(winding_rad(x, y) - self._wound[robot], math.tau)
        return self._wound.copy()


LIMIT_S = 120.0  #: Time limit of a run, s; the lap takes 77 s at the constant velocity.

_HOME_RAD = 0.1  # A lap may end at this angle before home, which is 0.3 m.


class End(Enum):
    """An `End` is the way in which a run ended."""

    SUCCESS = "success"
    CONTACT = "contact"
    STOP = "stop for an obstacle"
    TIMEOUT = "timeout"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """A `Verdict` is the end of a run."""

    end: End  #: Kind of the end.
    robot: int = -1  #: Index of the robot that failed; -1 if no robot or no single robot failed.


def judge(
    clearance_m: Sequence[float],
    wound_rad: Sequence[float],
    *,
    stopped_by: int | None,
) -> Verdict | None:
    """Return how a run has ended, or None while it continues. The caller checks the time limit.

    Args:
        clearance_m: Distance of each robot from its nearest wall, metres (`World`).
        wound_rad: Angle that each robot has driven around the ring, radians (`World.wound_rad`).
        stopped_by: Index of the robot whose obstacle stopped all robots; None for none.
    """
    for robot, clearance in enumerate(clearance_m):
        if clearance <= RADIUS_M:
            return Verdict(end=End.CONTACT, robot=robot)
    if stopped_by is not None:
        return Verdict(end=End.STOP, robot=stopped_by)
    if min(wound_rad) >= math.tau - _HOME_RAD:
        return Verdict(end=End.SUCCESS)
    return None
