"""The same path in more time, so that an agent's limits hold.

Segments are stretched where they violate something; what is left after some rounds is met by stretching
everything alike, which always ends: speeds fall with the factor, accelerations with its square. Durations only
grow. Not the shortest such motion; what is slow already is not made faster.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.trajectory.limits import Quantity, limit_violations, peaks
from sfglab.spatial.trajectory.motion import motion_of
from sfglab.spatial.trajectory.path import with_durations

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.spatial.trajectory.limits import Limits
    from sfglab.spatial.trajectory.path import Trajectory


_LOCAL_ROUNDS = 30
_CLOSE = 1e-6
"""Segments are stretched by this share more than needed, so that rounding to nanoseconds breaks no limit."""


def retimed(trajectory: Trajectory, limits: Limits) -> Trajectory:
    """Return a trajectory along the same path, position and orientation, that keeps to limits.

    Args:
        trajectory: What to slow down; the first waypoint keeps its time.
        limits: What must hold afterwards, as `limit_violations` sees it.

    Returns:
        The same object where nothing is violated.

    Raises:
        TrajectoryError: It would end later than a trajectory may.
    """
    for _ in range(_LOCAL_ROUNDS):
        if not limit_violations(trajectory, limits):
            return trajectory
        factors = _factors(trajectory, limits)
        trajectory = _slower(trajectory, factors)
    while limit_violations(trajectory, limits):
        trajectory = _slower(
            trajectory, np.full(len(trajectory.waypoints) - 1, _factors(trajectory, limits).max())
        )
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
