"""The module `course` has the hallway: one course for three areas, boxes in each area, and compiled wall geometry.

Paper B, Fig. 14: "move the robots by parallels in different areas". The paper draws the course without
measures. The course of sfglab is a ring of corridors with five corners to the right and one to the left. Lengths are
metres, x is to the right and y up. Poses are x, y and heading, shape (robots, 3). Walls are x, y of both ends, shape
(robots, walls, 4), with separate walls for each robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numba as nb
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

HALF_WIDTH_M = 0.5
"""Half of a corridor: 1 m is the narrowest that building codes allow for one person, and five robots wide."""

WAYPOINTS = ((0.0, 4.0), (3.0, 4.0), (3.0, 2.0), (5.0, 2.0), (5.0, 0.0), (0.0, 0.0))
"""Corners of the corridors' middle line, clockwise, in the direction in which the robots drive."""

#: Place where robots start and to which they return: x, y and heading; half a metre after a corner.
HOME = (1.0, 4.0, 0.0)

_PIVOT = (1.5, 1.0)  # Every point of the middle line sees this point inside the ring.
_HOME_RAD = math.atan2(HOME[1] - _PIVOT[1], HOME[0] - _PIVOT[0])
_BOX_LONG_M, _BOX_DEEP_M = 0.3, 0.2


@dataclass(frozen=True, slots=True)
class Box:
    """A `Box` is a cardboard box at a wall, 0.3 m long in the wall's direction and 0.2 m deep."""

    leg: int  #: Number of the corridor: the number of the waypoint where the corridor begins.
    along_m: float  #: Distance of the box's middle from the waypoint where the corridor begins, m.
    side: str  #: Side of the corridor in the driving direction: ``left`` or ``right``.

    def corners(self) -> NDArray[np.float64]:
        """Return x, y of the box's four corners, metres, shape (4, 2)."""
        start = np.array(WAYPOINTS[self.leg])
        ahead = np.array(WAYPOINTS[(self.leg + 1) % len(WAYPOINTS)]) - start
        ahead = ahead / np.linalg.norm(ahead)
        out = np.array((-ahead[1], ahead[0])) * (1.0 if self.side == "left" else -1.0)
        near, far = HALF_WIDTH_M - _BOX_DEEP_M, HALF_WIDTH_M
        first, last = self.along_m - _BOX_LONG_M / 2, self.along_m + _BOX_LONG_M / 2
        around = ((first, far), (first, near), (last, near), (last, far))
        return np.array([start + a * ahead + o * out for a, o in around])


@dataclass(frozen=True, kw_only=True)
class Area:
    """An `Area` is the hallway of one robot."""

    robot: str  #: Name of the robot.
    boxes: tuple[Box, ...] = ()  #: Boxes in the hallway.

    @cached_property
    def rings(self) -> list[NDArray[np.float64]]:
        """x, y of the corners of both walls and of each box, metres, in order, shape (n, 2) each."""
        boxes = [box.corners() for box in self.boxes]
        return [_offset(HALF_WIDTH_M), _offset(-HALF_WIDTH_M), *boxes]

    @cached_property
    def segments(self) -> NDArray[np.float64]:
        """Segments that a beam can hit: x, y of both ends, metres, shape (n, 4)."""
        sides = [np.hstack((ring, np.roll(ring, -1, axis=0))) for ring in self.rings]
        return np.concatenate(sides)


def _offset(outwards_m: float) -> NDArray[np.float64]:
    """Return the middle line moved outwards, corner by corner; the corridors meet at right angles."""
    points = np.array(WAYPOINTS)
    ahead = np.roll(points, -1, axis=0) - points
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    out = np.column_stack((-ahead[:, 1], ahead[:, 0])) * outwards_m
    moved: NDArray[np.float64] = points + out + np.roll(out, 1, axis=0)
    return moved


def winding_rad(x: float, y: float) -> float:
    """Return the angle of a position, metres, around the ring, radians from -pi to pi.

    The angle is 0 at the robots' start, and grows in the driving direction.
    """
    return math.remainder(_HOME_RAD - math.atan2(y - _PIVOT[1], x - _PIVOT[0]), math.tau)


AREAS = (
    Area(robot="robot1", boxes=(Box(4, 2.0, "left"), Box(4, 3.4, "right"), Box(5, 2.0, "left"))),
    Area(robot="robot2", boxes=(Box(4, 1.7, "right"), Box(4, 3.0, "left"), Box(5, 1.7, "right"))),
    Area(robot="robot3", boxes=(Box(3, 1.0, "right"), Box(4, 2.6, "left"), Box(5, 2.3, "right"))),
)
"""Areas of the three robots. Each area has three boxes at its own places; a box leaves 0.8 m of the corridor."""
ROBOTS = tuple(area.robot for area in AREAS)  #: Names of the robots.


@nb.njit(cache=True, nogil=True)
def scan(walls: Any, pose: Any, angles: Any, ranges: Any) -> None:
    """Write the distance from a pose to the nearest wall in each direction, metres, into `ranges`, shape (n,).

    Args:
        walls: x, y of both ends of each wall, metres, shape (walls, 4).
        pose: x, y (metres) and heading (radians), shape (3,).
        angles: Direction of each beam, radians to the left of the heading, shape (n,).
        ranges: The result; infinity for a beam that meets no wall.
    """
    for i in range(len(angles)):
        dx, dy = math.cos(pose[2] + angles[i]), math.sin(pose[2] + angles[i])
        nearest = np.inf
        for k in range(walls.shape[0]):
            ax, ay = walls[k, 0] - pose[0], walls[k, 1] - pose[1]
            ex, ey = walls[k, 2] - walls[k, 0], walls[k, 3] - walls[k, 1]
            across = dx * ey - dy * ex
            if across != 0.0:
                along = (ax * ey - ay * ex) / across
                share = (ax * dy - ay * dx) / across
                if 0.0 <= along < nearest and 0.0 <= share <= 1.0:
                    nearest = along
        ranges[i] = nearest


@nb.njit(cache=True, nogil=True)
def clearances(walls: Any, poses: Any, result: Any) -> None:
    """Write the distance from each robot's middle to its nearest wall, metres, into `result`, shape (robots,).

    The argument `walls` has the shape (robots, walls, 4), and `poses` the shape (robots, 3), as in this module's text.
    """
    for r in range(poses.shape[0]):
        nearest = np.inf
        for k in range(walls.shape[1]):
            ax, ay = walls[r, k, 0], walls[r, k, 1]
            ex, ey = walls[r, k, 2] - ax, walls[r, k, 3] - ay
            px, py = poses[r, 0] - ax, poses[r, 1] - ay
            share = min(1.0, max(0.0, (px * ex + py * ey) / (ex * ex + ey * ey)))
            nearest = min(nearest, math.hypot(px - share * ex, py - share * ey))
        result[r] = nearest


@nb.njit(cache=True, nogil=True)
def drive(poses: Any, wheels: Any, base_m: float, dt_s: float) -> None:
    """Move robots with differential drive along arcs, in place.

    Args:
        poses: x, y (metres) and heading (radians), shape (robots, 3); the function changes it.
        wheels: Speeds of the left and the right wheel, m/s, shape (robots, 2).
        base_m: Distance between the wheels, metres.
        dt_s: Duration, seconds.
    """
    for r in range(poses.shape[0]):
        ahead = 0.5 * (wheels[r, 0] + wheels[r, 1]) * dt_s
        turn = (wheels[r, 1] - wheels[r, 0]) / base_m * dt_s
        # The robot moves along the arc's chord, which is exact up to the third order of the turn of below 0.01 rad.
        middle = poses[r, 2] + 0.5 * turn
        poses[r, 0] += ahead * math.cos(middle)
        poses[r, 1] += ahead * math.sin(middle)
        poses[r, 2] += turn
