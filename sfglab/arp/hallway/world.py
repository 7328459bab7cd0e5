"""Three robots in three areas: what their motors do, what they hit, and what their LIDARs see.

Each is a TurtleBot3 Burger: differential drive, radius 0.105 m, wheels 0.160 m apart, 0.22 m/s at most (ROBOTIS
e-manual). Wheels differ a little and slip a little, and robots are put down by hand; a seed draws both. Knows
physics; refuses to know messages and decisions.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.hallway.course import AREAS, HOME, winding_rad
from sfglab.arp.hallway.lidar import BEAMS_DEG, step_from_range
from sfglab.arp.hallway.rays import clearances, drive, scan

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.arp.hallway.course import Area
    from sfglab.arp.hallway.nodes import Command


RADIUS_M = 0.105
"""Of the robot's body; closer to a wall is a contact."""

STEP_NS = 20_000_000
"""One step: the controller board sets the motors 50 times a second."""

_BASE_M = 0.160
_WHEEL_SIGMA = 0.005  # wheels of one robot differ by tyres and wear
_SLIP_SIGMA = 0.05  # of one step's way; over a metre it comes to 3 mm
_PUT_SIGMA_M, _PUT_SIGMA_RAD = 0.01, math.radians(1.0)
_ANGLES = np.radians(BEAMS_DEG)


class World:
    """The physics of one run.

    Args:
        seed: Of where robots stand at first, how their wheels differ and how they slip.
        areas: One for each robot.

    Attributes:
        poses: x, y (metres) and heading (radians) of each robot, shape (robots, 3).
        clearance_m: From each robot's middle to the nearest wall, shape (robots,).
    """

    def __init__(self, *, seed: int, areas: Sequence[Area] = AREAS) -> None:
        self._random = np.random.default_rng(seed)
        robots = len(areas)
        most = max(len(area.segments) for area in areas)
        padded = [
            np.concatenate((a.segments, a.segments[:1].repeat(most - len(a.segments), axis=0))) for a in areas
        ]
        self._walls = np.ascontiguousarray(padded)
        put = self._random.normal(size=(robots, 3)) * (_PUT_SIGMA_M, _PUT_SIGMA_M, _PUT_SIGMA_RAD)
        self.poses: NDArray[np.float64] = np.array(HOME) + put
        self._scale = 1.0 + self._random.normal(size=(robots, 2)) * _WHEEL_SIGMA
        self.clearance_m = np.empty(robots)
        self._ranges = np.empty(len(_ANGLES))
        self._wound = np.array([winding_rad(x, y) for x, y, _ in self.poses])
        clearances(self._walls, self.poses, self.clearance_m)

    def step(self, commands: Sequence[Command]) -> None:
        """Let every robot execute its command for `STEP_NS`."""
        speeds = np.array([(c.speed_m_s, c.turn_rad_s * _BASE_M / 2) for c in commands])
        wheels = speeds[:, :1] + speeds[:, 1:] * (-1.0, 1.0)
        slip = self._random.normal(size=wheels.shape) * _SLIP_SIGMA
        drive(self.poses, wheels * (self._scale + slip), _BASE_M, STEP_NS / 1e9)
        clearances(self._walls, self.poses, self.clearance_m)

    def scan(self, robot: int) -> list[int]:
        """Return what a robot's LIDAR measures: a step for each of `BEAMS_DEG`."""
        scan(self._walls[robot], self.poses[robot], _ANGLES, self._ranges)
        return [step_from_range(range_m) for range_m in self._ranges]

    def wound_rad(self) -> NDArray[np.float64]:
        """Return how far around the ring each robot has come, 2 pi being a round, shape (robots,).

        To be called at least once in a quarter of a round.
        """
        for robot, (x, y, _) in enumerate(self.poses):
            ahead = math.remainder(winding_rad(x, y) - self._wound[robot], math.tau)
            self._wound[robot] += ahead
        return self._wound.copy()
