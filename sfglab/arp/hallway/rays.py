"""Compiled geometry: beams against walls, distance to walls, and motion of differential drives.

Poses are x, y and heading, shape (robots, 3); walls are x, y of both ends, shape (robots, walls, 4), each
robot's own, padded with copies of the first.
"""

from __future__ import annotations

import math
from typing import Any

import numba as nb
import numpy as np


@nb.njit(cache=True, nogil=True)
def scan(walls: Any, pose: Any, angles: Any, ranges: Any) -> None:
    """Write the distance to the next wall in each direction into `ranges`; infinity where there is none.

    Args:
        walls: Shape (walls, 4).
        pose: x, y and heading.
        angles: Directions from the heading, radians, shape (n,).
        ranges: Result, shape (n,).
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
    """Write each robot's distance from its middle to the nearest wall into `result`, shape (robots,)."""
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
    """Move each robot along the arc that its wheels' speeds make.

    Args:
        poses: Changed in place.
        wheels: Speed of the left and the right wheel, m/s, shape (robots, 2).
        base_m: From wheel to wheel.
        dt_s: How long.
    """
    for r in range(poses.shape[0]):
        ahead = 0.5 * (wheels[r, 0] + wheels[r, 1]) * dt_s
        turn = (wheels[r, 1] - wheels[r, 0]) / base_m * dt_s
        # The chord of the arc: exact up to the third order of the turn, which is below 0.01 rad here.
        middle = poses[r, 2] + 0.5 * turn
        poses[r, 0] += ahead * math.cos(middle)
        poses[r, 1] += ahead * math.sin(middle)
        poses[r, 2] += turn
