"""A trajectory as a value: timed poses and how to go from one to the next. Paper A, section 4.5.

The paper's T = {(p_i, t_i)}, p_i in SE(3), t_i a temporal offset from 0. Times are whole nanoseconds, so that
files and messages give back what they were given. What lies between waypoints is `motion`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.spatial.poses import Pose, Quat, Vec3
from sfglab.tables import html_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

#: Eleven days: up to here a float in seconds with nine decimals gives back its ns.
LATEST_NS = 10**15


class TrajectoryError(InvalidValueError):
    """Values that are no trajectory, or a message or text that holds none."""

    def __str__(self) -> str:
        return f"{self.place}: given {self.given}, allowed: {self.allowed}"


class Interpolation(Enum):
    """How to go from one waypoint to the next; `motion` has the formulas."""

    POLYLINE = "polyline"  #: Position linear in time, orientation by SLERP; the paper's.
    #: Position on a centripetal Catmull-Rom spline, orientation by SLERP.
    CATMULL_ROM = "catmull_rom"


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """Where to be, and when."""

    time_ns: int  #: Since the trajectory's time 0, 0 to `LATEST_NS`.
    pose: Pose  #: Where, and how turned.


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Waypoints in order of time. Before the first and after the last, one stands there.

    Raises:
        TrajectoryError: There is no waypoint, a time is out of range, or times do not grow.
    """

    waypoints: tuple[Waypoint, ...]  #: At least one; their times grow strictly.
    interpolation: Interpolation = Interpolation.POLYLINE  #: How to go from one to the next.

    def __post_init__(self) -> None:
        if not self.waypoints:
            raise TrajectoryError("trajectory", "no waypoint", "at least one")
        before = -1
        for index, waypoint in enumerate(self.waypoints):
            if not before < waypoint.time_ns <= LATEST_NS:
                allowed = f"whole nanoseconds above {before} and up to {LATEST_NS}"
                raise TrajectoryError(f"waypoint {index}, time", f"{waypoint.time_ns} ns", allowed)
            before = waypoint.time_ns

    def __repr__(self) -> str:
        count, took_s = len(self.waypoints), (self.end_ns - self.start_ns) / 1e9
        return f"<trajectory, {self.interpolation.value}: {count} waypoints, {took_s:g} s>"

    def _repr_html_(self) -> str:
        rows = [
            (f"{w.time_ns / 1e9:g}", *(f"{c:.3f}" for c in (*w.pose.position_m, *w.pose.quat_xyzw)))
            for w in self.waypoints
        ]
        return html_table([("s", *"xyz", "qx", "qy", "qz", "qw"), *rows], repr(self)[1:-1])

    @property
    def start_ns(self) -> int:
        """The first waypoint's time."""
        return self.waypoints[0].time_ns

    @property
    def end_ns(self) -> int:
        """The last waypoint's time."""
        return self.waypoints[-1].time_ns

    @classmethod
    def of(
        cls,
        waypoints: Iterable[tuple[int, Pose]],
        interpolation: Interpolation = Interpolation.POLYLINE,
    ) -> Trajectory:
        """Return the trajectory of pairs of nanoseconds and pose."""
        listed = tuple(Waypoint(time_ns=time_ns, pose=pose) for time_ns, pose in waypoints)
        return cls(waypoints=listed, interpolation=interpolation)

    @classmethod
    def standing(cls, pose: Pose) -> Trajectory:
        """Return the trajectory of whoever stays where they are."""
        return cls.of([(0, pose)])


def in_frame(trajectory: Trajectory, target_from_source: Pose) -> Trajectory:
    """Return a trajectory in another frame; both interpolations commute with rigid motions."""
    if target_from_source == Pose():
        return trajectory
    moved = tuple(replace(w, pose=target_from_source @ w.pose) for w in trajectory.waypoints)
    return replace(trajectory, waypoints=moved)


def with_durations(trajectory: Trajectory, durations_ns: Iterable[int]) -> Trajectory:
    """Return the same waypoints with other durations between them; the first keeps its time.

    Raises:
        TrajectoryError: A duration is not above zero, or the end lies too late.
        ValueError: There is another number of durations.
    """
    time_ns = trajectory.start_ns
    moved = [trajectory.waypoints[0]]
    for waypoint, duration_ns in zip(trajectory.waypoints[1:], durations_ns, strict=True):
        time_ns += int(duration_ns)
        moved.append(replace(waypoint, time_ns=time_ns))
    return replace(trajectory, waypoints=tuple(moved))


def stretched(trajectory: Trajectory, factor: float) -> Trajectory:
    """Return the same path with durations `factor` times as long; the first waypoint keeps its time.

    Raises:
        TrajectoryError: The factor is not above zero, waypoints fall together, or the end lies too late.
    """
    if not 0.0 < factor < float("inf"):
        raise TrajectoryError("factor", factor, "a finite number above zero")
    start_ns = trajectory.start_ns
    times = [start_ns + round((w.time_ns - start_ns) * factor) for w in trajectory.waypoints]
    return with_durations(trajectory, [after - before for before, after in pairwise(times)])


_FLAT_M = 1e-9  #: Horizontal distances up to here say nothing about a heading.


class Align(Enum):
    """What a waypoint's x axis points along."""

    NONE = "none"  #: Its own orientation.
    PREVIOUS = "previous"  #: The segment that arrives, from the previous waypoint.
    NEXT = "next"  #: The segment that leaves, to the next waypoint.


def heading_quat(start_m: Vec3, end_m: Vec3) -> Quat | None:
    """Return the orientation x, y, z, w, without roll, whose x axis points from one position to the other.

    None where the two lie above each other or together, as there is no yaw then.
    """
    dx, dy, dz = (b - a for a, b in zip(start_m, end_m, strict=True))
    flat = math.hypot(dx, dy)
    if flat <= _FLAT_M:
        return None
    yaw, pitch = math.atan2(dy, dx) / 2, -math.atan2(dz, flat) / 2
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    return (-sy * sp, cy * sp, sy * cp, cy * cp)


def aligned_quat(positions_m: Sequence[Vec3], index: int, align: Align) -> Quat | None:
    """Return the orientation x, y, z, w of a waypoint that looks along a neighbouring segment; None: its own.

    The first waypoint has only the segment that leaves, the last only the one that arrives; they take that.
    """
    if align is Align.NONE or len(positions_m) < 2:
        return None
    start = index - 1 if align is Align.PREVIOUS else index
    start = min(max(start, 0), len(positions_m) - 2)
    return heading_quat(positions_m[start], positions_m[start + 1])


def align_waypoint(trajectory: Trajectory, index: int, align: Align) -> Trajectory:
    """Return a trajectory with one waypoint turned along a neighbouring segment, as `aligned_quat` has it."""
    points = trajectory.waypoints
    quat = aligned_quat([w.pose.position_m for w in points], index, align)
    if quat is None:
        return trajectory
    pose = Pose(position_m=points[index].pose.position_m, quat_xyzw=quat)
    turned = replace(points[index], pose=pose)
    return replace(trajectory, waypoints=(*points[:index], turned, *points[index + 1 :]))
