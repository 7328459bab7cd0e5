"""Random trajectories, seeded, and how a property is checked on many of them.

A trial draws a case and says what is wrong with it; the empty text says that the property holds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.checks import CheckRow
from sfglab.spatial import Pose
from sfglab.spatial.trajectory import Interpolation, Limits, Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    Trial = Callable[[np.random.Generator], str]


EITHER = tuple(Interpolation)
_NS_PER_S = 1_000_000_000
_REACH_M = 5.0
_WAIT = 0.15
"""Share of waypoints that stand where the one before stands."""


def random_pose(rng: np.random.Generator) -> Pose:
    """Return a pose within some metres, turned in any way."""
    return Pose.at(rng.uniform(-_REACH_M, _REACH_M, 3), rng.normal(size=4))


def random_trajectory(
    rng: np.random.Generator, *, least: int = 2, kinds: tuple[Interpolation, ...] = EITHER
) -> Trajectory:
    """Return a trajectory with dense and far apart times, turns on the spot, and any interpolation."""
    time_ns, found = int(rng.integers(0, 5 * _NS_PER_S)), [random_pose(rng)]
    times = [time_ns]
    for _ in range(int(rng.integers(least, 8)) - 1):
        time_ns += round(_NS_PER_S * float(rng.choice([0.05, 0.5, 1.0, 3.0])) * rng.uniform(0.5, 2.0))
        times.append(time_ns)
        there = random_pose(rng)
        waits = rng.random() < _WAIT
        found.append(Pose.at(found[-1].position_m, there.quat_xyzw) if waits else there)
    return Trajectory.of(zip(times, found, strict=True), kinds[int(rng.integers(len(kinds)))])


def random_limits(rng: np.random.Generator) -> Limits:
    """Return limits, one of them missing now and then."""
    speed, acceleration, yaw_rate = (
        None if rng.random() < 0.1 else float(rng.uniform(0.3, 3.0)) for _ in range(3)
    )
    return Limits(speed_m_s=speed, acceleration_m_s2=acceleration, yaw_rate_rad_s=yaw_rate)


def checked(trials: Iterable[tuple[str, Trial]], count: int, seed: int) -> Iterator[CheckRow]:
    """Yield a row for every property.

    Args:
        trials: The properties and their trials.
        count: Cases of each.
        seed: Of the cases; each property has cases of its own.
    """
    for place, (name, trial) in enumerate(trials):
        rng = np.random.default_rng([seed, place])
        wrong = [problem for problem in (trial(rng) for _ in range(count)) if problem]
        yield CheckRow(
            check=name, checked=count, held=count - len(wrong), example=wrong[0] if wrong else "all of them"
        )
