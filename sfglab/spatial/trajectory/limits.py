"""Speed, acceleration and yaw rate against an agent's limits; the same path in more time, so that they hold.

A polyline's velocity jumps at its waypoints; there the acceleration is the jump over half the time of the two
segments, |v_out - v_in| / ((dt_in + dt_out) / 2). The first waypoint may be left, and the last reached, at any
speed within the limit. A spline's peaks are sought on a grid that is narrowed thrice.

Re-timing stretches segments where they violate something, and at last everything alike, which always ends:
speeds fall with the factor, accelerations with its square. Not the shortest such motion; durations only grow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.trajectory.motion import Motion, motion_of
from sfglab.spatial.trajectory.path import Trajectory, TrajectoryError, with_durations

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from sfglab.spatial.poses import Vec3

_GRID = 65
_ZOOMS = 3
_TOLERANCE = 1e-9


class Quantity(Enum):
    """What is limited."""

    SPEED = "speed_m_s"  #: Length of the velocity, m/s.
    ACCELERATION = "acceleration_m_s2"  #: Length of the acceleration, m/s^2.
    YAW_RATE = "yaw_rate_rad_s"  #: Size of the angular velocity about the fixed z axis, rad/s.


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What an agent can do, None for no limit; TrajectoryError where one is no finite number above zero."""

    speed_m_s: float | None = None  #: Above zero.
    acceleration_m_s2: float | None = None  #: Above zero.
    yaw_rate_rad_s: float | None = None  #: Above zero.

    def __post_init__(self) -> None:
        for quantity in Quantity:
            limit = self.of(quantity)
            if limit is not None and not 0.0 < limit < math.inf:
                raise TrajectoryError(
                    f"limits, {quantity.value}", limit, "a finite number above zero, or none"
                )

    def of(self, quantity: Quantity) -> float | None:
        """Return the limit of a quantity."""
        limit: float | None = getattr(self, quantity.value)
        return limit


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitViolation:
    """A segment, or a polyline's corner, where a limit is exceeded."""

    quantity: Quantity  #: Which limit.
    segment: int  #: From 0; a corner counts to the segment that leaves it.
    time_s: float  #: Where it is exceeded most.
    position_m: Vec3  #: The position then.
    value: float  #: In the quantity's unit.
    limit: float  #: What is allowed.

    def __str__(self) -> str:
        x, y, z = self.position_m
        where = f"at {self.time_s:.3f} s, ({x:.2f}, {y:.2f}, {z:.2f}) m, segment {self.segment}"
        return f"{self.quantity.value}: given {self.value:.4g} {where}, allowed {self.limit:.4g}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Peaks:
    """The largest value of a quantity in every segment."""

    values: NDArray[np.float64]  #: Shape (n - 1,), in the quantity's unit.
    times_s: NDArray[np.float64]  #: When, shape (n - 1,).


def peaks(trajectory: Trajectory, quantity: Quantity) -> Peaks:
    """Return where a quantity is largest in every segment; a corner counts to the one that leaves it."""
    motion = motion_of(trajectory)
    return (_exact_peaks if motion.exact else _narrowed_peaks)(motion, quantity)


def limit_violations(trajectory: Trajectory, limits: Limits) -> tuple[LimitViolation, ...]:
    """Return every segment in which a limit is exceeded by more than a part in 10^9, for rounding, by time."""
    found = [
        v
        for quantity in Quantity
        for v in _violations_of(trajectory, quantity, limits.of(quantity))
    ]
    return tuple(sorted(found, key=lambda v: (v.time_s, v.quantity.value)))


def _violations_of(
    trajectory: Trajectory, quantity: Quantity, limit: float | None
) -> Iterator[LimitViolation]:
    if limit is None:
        return
    found = peaks(trajectory, quantity)
    motion = motion_of(trajectory)
    for segment in np.flatnonzero(found.values > limit * (1.0 + _TOLERANCE)):
        x, y, z = motion.positions(found.times_s[segment])[0].tolist()
        yield LimitViolation(
            quantity=quantity,
            segment=int(segment),
            time_s=float(found.times_s[segment]),
            position_m=(x, y, z),
            value=float(found.values[segment]),
            limit=limit,
        )


def _exact_peaks(motion: Motion, quantity: Quantity) -> Peaks:
    """Return a polyline's peaks: rates are constant in a segment, and jumps stand at its start."""
    count = len(motion)
    _, velocity, _, angular = motion.rates(np.arange(count), np.zeros(count))
    starts = motion.times_s[:-1]
    if quantity is Quantity.SPEED:
        return Peaks(values=np.linalg.norm(velocity, axis=1), times_s=starts)
    if quantity is Quantity.YAW_RATE:
        return Peaks(values=np.abs(angular[:, 2]), times_s=starts)
    jumps = np.zeros(count)
    if count > 1:
        spread_s = (motion.durations_s[:-1] + motion.durations_s[1:]) / 2.0
        jumps[1:] = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / spread_s
    return Peaks(values=jumps, times_s=starts)


def _narrowed_peaks(motion: Motion, quantity: Quantity) -> Peaks:
    """Return a spline's peaks: the best point of a grid over each segment, then of grids around that point."""
    count, rows = len(motion), np.arange(len(motion))
    low, high = np.zeros(count), motion.durations_s
    best_s, values = low, low
    for _ in range(_ZOOMS + 1):
        grid = np.linspace(low, high, _GRID, axis=1)
        sizes = _sizes(motion, quantity, np.repeat(rows, _GRID), grid.ravel()).reshape(count, _GRID)
        best = sizes.argmax(axis=1)
        best_s, values = grid[rows, best], sizes[rows, best]
        low, high = grid[rows, np.maximum(best - 1, 0)], grid[rows, np.minimum(best + 1, _GRID - 1)]
    return Peaks(values=values, times_s=motion.times_s[:-1] + best_s)


def _sizes(
    motion: Motion, quantity: Quantity, segments: NDArray[np.intp], local_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    _, velocity, acceleration, angular = motion.rates(segments, local_s)
    if quantity is Quantity.YAW_RATE:
        return np.abs(angular[:, 2])
    return np.asarray(
        np.linalg.norm(velocity if quantity is Quantity.SPEED else acceleration, axis=1)
    )


_LOCAL_ROUNDS = 30
_CLOSE = 1e-6  #: By which more than needed segments are stretched: rounding to ns breaks no limit.


def retimed(trajectory: Trajectory, limits: Limits) -> Trajectory:
    """Return a trajectory along the same path, from the same time on, that keeps to limits; itself if it does.

    Raises:
        TrajectoryError: It would end later than a trajectory may.
    """
    for _ in range(_LOCAL_ROUNDS):
        if not limit_violations(trajectory, limits):
            return trajectory
        trajectory = _slower(trajectory, _factors(trajectory, limits))
    while limit_violations(trajectory, limits):
        factors = _factors(trajectory, limits)
        trajectory = _slower(trajectory, np.full_like(factors, factors.max()))
    return trajectory


def _factors(trajectory: Trajectory, limits: Limits) -> NDArray[np.float64]:
    """Return by how much each segment must at least be stretched."""
    factors = np.ones(len(trajectory.waypoints) - 1)
    for quantity in Quantity:
        limit = limits.of(quantity)
        if limit is None:
            continue
        ratio = peaks(trajectory, quantity).values / limit
        if quantity is Quantity.ACCELERATION:
            ratio = np.sqrt(ratio)
            if motion_of(trajectory).exact:  # a corner belongs to both of its segments
                ratio[:-1] = np.maximum(ratio[:-1], ratio[1:])
        factors = np.maximum(factors, ratio)
    return factors


def _slower(trajectory: Trajectory, factors: NDArray[np.float64]) -> Trajectory:
    times_ns = np.array([w.time_ns for w in trajectory.waypoints])
    grown = np.where(factors > 1.0, factors * (1.0 + _CLOSE), 1.0)
    # at least one more nanosecond, so that rounds always move
    durations = np.maximum(np.ceil(np.diff(times_ns) * grown), np.diff(times_ns) + (factors > 1.0))
    return with_durations(trajectory, (int(d) for d in np.minimum(durations, 2**62)))
