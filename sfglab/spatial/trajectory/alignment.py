"""Headings along the way: a waypoint looks away from its predecessor or at its successor.

Paper A, section 4.5. Refuses to know whether somebody asked for it once or for good.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.spatial.poses import Pose, Quat, Vec3

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.spatial.trajectory.path import Trajectory


_FLAT_M = 1e-9
"""Horizontal distances up to here say nothing about a heading."""


class Align(Enum):
    """What a waypoint's x axis points along.

    Attributes:
        NONE: Its own orientation.
        PREVIOUS: The segment that arrives, from the previous waypoint.
        NEXT: The segment that leaves, to the next waypoint.
    """

    NONE = "none"
    PREVIOUS = "previous"
    NEXT = "next"


def heading_quat(start_m: Vec3, end_m: Vec3) -> Quat | None:
    """Return the orientation whose x axis points from one position to the other, without roll.

    Returns:
        x, y, z, w, of yaw and pitch; None where the two lie above each other or together, as there is no yaw
        then.
    """
    dx, dy, dz = (b - a for a, b in zip(start_m, end_m, strict=True))
    flat = math.hypot(dx, dy)
    if flat <= _FLAT_M:
        return None
    yaw, pitch = math.atan2(dy, dx) / 2, -math.atan2(dz, flat) / 2
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return (-sy * sp, cy * sp, sy * cp, cy * cp)


def aligned_quat(positions_m: Sequence[Vec3], index: int, align: Align) -> Quat | None:
    """Return the orientation of a waypoint that looks along a neighbouring segment.

    Args:
        positions_m: The waypoints'.
        index: Which waypoint.
        align: Along which segment. The first waypoint has only the one that leaves, the last only the one that
            arrives; they take what there is.

    Returns:
        x, y, z, w; None where the waypoint keeps its own: for `Align.NONE`, and along a segment without yaw.
    """
    if align is Align.NONE or len(positions_m) < 2:
        return None
    start = index - 1 if align is Align.PREVIOUS else index
    start = min(max(start, 0), len(positions_m) - 2)
    return heading_quat(positions_m[start], positions_m[start + 1])


def align_waypoint(trajectory: Trajectory, index: int, align: Align) -> Trajectory:
    """Return a trajectory with one waypoint turned along a neighbouring segment, as `aligned_quat` has it.

    Args:
        trajectory: What to change.
        index: Which waypoint, from 0.
        align: Along which segment.
    """
    points = trajectory.waypoints
    quat = aligned_quat([w.pose.position_m for w in points], index, align)
    if quat is None:
        return trajectory
    pose = Pose(position_m=points[index].pose.position_m, quat_xyzw=quat)
    turned = replace(points[index], pose=pose)
    return replace(trajectory, waypoints=(*points[:index], turned, *points[index + 1 :]))
