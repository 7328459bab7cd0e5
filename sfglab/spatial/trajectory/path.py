"""A trajectory as a value: timed poses and their interpolation. Paper A, section 4.5.

It is the paper's T = {(p_i, t_i)}, with p_i in SE(3) and t_i an offset from time 0. Times are whole nanoseconds, so
that files and messages reproduce them exactly. `motion` computes the poses between waypoints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.spatial.poses import Pose, Quat, Vec3

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

#: Latest time of a waypoint, 11 days: up to here a float in seconds has all nanoseconds.
LATEST_NS = 10**15
_FLAT_M = 1e-9  # horizontal distances up to here have no heading


class Interpolation(Enum):
    """Way from one waypoint to the next; `motion` has the formulas."""

    POLYLINE = "polyline"  #: Position linear in time, orientation by SLERP, as in the paper.
    #: Position on a centripetal Catmull-Rom spline, orientation by SLERP.
    CATMULL_ROM = "catmull_rom"


class Align(Enum):
    """Direction of a waypoint's x axis."""

    NONE = "none"  #: The waypoint's own orientation.
    PREVIOUS = "previous"  #: Along the segment that arrives, from the previous waypoint.
    NEXT = "next"  #: Along the segment that leaves, to the next waypoint.


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """A pose of a trajectory at a time."""

    time_ns: int  #: Time since the trajectory's time 0, ns, up to `LATEST_NS`.
    pose: Pose  #: Pose at that time.


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Waypoints in order of time. Before the first and after the last, the pose is constant.

    Raises:
        InvalidValueError: There is no waypoint, a time is out of range, or times do not grow.
    """

    waypoints: tuple[Waypoint, ...]  #: Waypoints, at least one, with strictly growing times.
    interpolation: Interpolation = Interpolation.POLYLINE  #: Way from one to the next.

    def __post_init__(self) -> None:
        if not self.waypoints:
            raise InvalidValueError("trajectory", self.waypoints, "at least one waypoint")
        before = -1
        for index, waypoint in enumerate(self.waypoints):
            if not before < waypoint.time_ns <= LATEST_NS:
                allowed = f"whole nanoseconds above {before} and up to {LATEST_NS}"
                raise InvalidValueError(f"waypoint {index}, time", waypoint.time_ns, allowed)
            before = waypoint.time_ns

    @property
    def start_ns(self) -> int:
        """Time of the first waypoint, ns."""
        return self.waypoints[0].time_ns

    @property
    def end_ns(self) -> int:
        """Time of the last waypoint, ns."""
        return self.waypoints[-1].time_ns

    @classmethod
    def of(
        cls,
        waypoints: Iterable[tuple[int, Pose]],
        interpolation: Interpolation = Interpolation.POLYLINE,
    ) -> Trajectory:
        """Return the trajectory of pairs of a time in nanoseconds and a pose."""
        listed = tuple(Waypoint(time_ns=time_ns, pose=pose) for time_ns, pose in waypoints)
        return cls(waypoints=listed, interpolation=interpolation)

    @classmethod
    def standing(cls, pose: Pose) -> Trajectory:
        """Return the trajectory of an agent that stays at a pose."""
        return cls.of([(0, pose)])


def in_frame(trajectory: Trajectory, target_from_source: Pose) -> Trajectory:
    """Return a trajectory in another frame; both interpolations commute with rigid motions, so the result is exact."""
    if target_from_source == Pose():
        return trajectory
    moved = tuple(replace(w, pose=target_from_source @ w.pose) for w in trajectory.waypoints)
    return replace(trajectory, waypoints=moved)


def heading_quat(start_m: Vec3, end_m: Vec3) -> Quat | None:
    """Return the orientation x, y, z, w without roll whose x axis points from one position to the other.

    The result is None if one position is above the other, or both are equal, because then there is no yaw.
    """
    dx, dy, dz = (b - a for a, b in zip(start_m, end_m, strict=True))
    flat = math.hypot(dx, dy)
    if flat <= _FLAT_M:
        return None
    half = -math.atan2(dz, flat) / 2
    pitched = Pose(quat_xyzw=(0.0, math.sin(half), 0.0, math.cos(half)))
    return (Pose.from_yaw(start_m, math.atan2(dy, dx)) @ pitched).quat_xyzw


def aligned_quat(positions_m: Sequence[Vec3], index: int, align: Align) -> Quat | None:
    """Return the orientation x, y, z, w of an aligned waypoint; None if the waypoint keeps its own orientation.

    The first waypoint has only the segment that leaves, and the last only the segment that arrives.
    """
    if align is Align.NONE or len(positions_m) < 2:
        return None
    start = index - 1 if align is Align.PREVIOUS else index
    start = min(max(start, 0), len(positions_m) - 2)
    return heading_quat(positions_m[start], positions_m[start + 1])
