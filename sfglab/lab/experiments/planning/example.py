"""One trajectory in four ways: as polyline and as spline, too fast as it was drawn and within limits."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.planning.rows import PlanningSampleRow
from sfglab.spatial import Pose
from sfglab.spatial.trajectory import Interpolation, Limits, Quantity, Trajectory, peaks, retimed, sample

if TYPE_CHECKING:
    from collections.abc import Iterator


EXAMPLE_LIMITS = Limits(speed_m_s=1.0, acceleration_m_s2=1.0)
EXAMPLE_M = ((0.0, 0.0), (1.2, 0.3), (1.5, 1.5), (3.0, 1.5), (3.3, 1.3), (5.0, 0.0))
"""Where the waypoints lie, a second apart as drawn; some far from each other and some close."""
_NS_PER_S = 1_000_000_000
_SAMPLES = 160


def example_rows() -> Iterator[PlanningSampleRow]:
    """Yield the example's moments, by interpolation and timing."""
    pairs = ((i * _NS_PER_S, Pose.at((x, y, 0.0))) for i, (x, y) in enumerate(EXAMPLE_M))
    drawn = Trajectory.of(pairs)
    for kind, slow in product(Interpolation, (False, True)):
        path = replace(drawn, interpolation=kind)
        yield from _rows(retimed(path, EXAMPLE_LIMITS) if slow else path, retimed_=slow)


def _rows(path: Trajectory, *, retimed_: bool) -> Iterator[PlanningSampleRow]:
    corners = [w.time_ns / _NS_PER_S for w in path.waypoints]
    grid = np.linspace(corners[0], corners[-1], _SAMPLES)
    times = np.unique(np.concatenate([grid, corners]))
    found = sample(path, times)
    top = peaks(path, Quantity.ACCELERATION)
    jumps = dict(zip(top.times_s.tolist(), top.values.tolist(), strict=True))
    polyline = path.interpolation is Interpolation.POLYLINE
    for i, time_s in enumerate(times.tolist()):
        yield PlanningSampleRow(
            interpolation=path.interpolation.value,
            retimed=retimed_,
            t_s=time_s,
            x_m=float(found.positions_m[i, 0]),
            y_m=float(found.positions_m[i, 1]),
            speed_m_s=float(found.speeds_m_s[i]),
            acceleration_m_s2=float(np.linalg.norm(found.accelerations_m_s2[i])),
            waypoint=time_s in corners,
            jump_m_s2=jumps.get(time_s, 0.0) if polyline and time_s in corners else 0.0,
        )
