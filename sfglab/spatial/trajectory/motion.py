"""Motion between waypoints: poses and their rates at any time, for whole arrays of times.

Each segment is a path P(g) with g from 0 to 1, driven by a law g(t); both are cubics.

- Polyline: P is linear, and g is linear in time (paper A, section 4.5).
- Centripetal Catmull-Rom: P is the cubic of Barry and Goldman's pyramid, with knots u_(i+1) - u_i =
  |p_(i+1) - p_i|^0.5; the phantom points before the first and after the last are mirrored. u(t) is the
  monotone cubic through (t_i, u_i). The velocity is therefore continuous, no agent drives backwards, and a
  wait (two waypoints at one place) begins and ends at rest. The path does not depend on times.
- Orientation: SLERP with the same g. It never leaves the arc between its neighbours, and its rate has a
  closed form.

Sources: P. J. Barry and R. N. Goldman: A recursive evaluation algorithm for a class of Catmull-Rom splines,
SIGGRAPH 1988; C. Yuksel, S. Schaefer, J. Keyser: Parameterization and applications of Catmull-Rom curves, 2011;
F. N. Fritsch and J. Butland: A method for constructing local monotone piecewise cubic interpolants, 1984; K.
Shoemake: Animating rotation with quaternion curves, SIGGRAPH 1985.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.poses import Pose
from sfglab.spatial.trajectory.path import Interpolation, Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]


_TOGETHER_M = 1e-9  # distance below which waypoints of a spline are at one place
_ALPHA = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """Poses and velocities of a trajectory at n times, in the trajectory's frame."""

    times_s: Floats  #: Times, shape (n,), s.
    positions_m: Floats  #: Positions, shape (n, 3), m.
    quats_xyzw: Floats  #: Orientations, shape (n, 4); q and -q are the same.
    #: Velocities, shape (n, 3), m/s; at a waypoint, of the segment that leaves.
    velocities_m_s: Floats
    angular_rad_s: Floats  #: Angular velocities in the fixed frame, shape (n, 3), rad/s.

    @property
    def speeds_m_s(self) -> Floats:
        """Lengths of the velocities, m/s, shape (n,)."""
        return np.asarray(np.linalg.norm(self.velocities_m_s, axis=1))

    def pose(self, index: int) -> Pose:
        """Return the pose of the sample with an index from 0."""
        position, quat = self.positions_m[index].tolist(), self.quats_xyzw[index].tolist()
        return Pose.at(position, quat, place=f"sample {index}")


class Motion:
    """The segments of a trajectory as polynomials; `motion_of` caches those in use."""

    def __init__(self, trajectory: Trajectory) -> None:
        from scipy.spatial.transform import Rotation

        points = trajectory.waypoints
        #: Times of the waypoints, shape (n,), s.
        self.times_s = np.array([w.time_ns for w in points]) / NS_PER_S
        self._knots_s = self.times_s
        if len(points) == 1:  # a segment of a second, in which nothing moves
            points *= 2
            self._knots_s = self.times_s + np.arange(2.0)
        self._rotations = Rotation.from_quat([w.pose.quat_xyzw for w in points])
        self._turns = (self._rotations[1:] * self._rotations[:-1].inv()).as_rotvec()
        positions = np.array([w.pose.position_m for w in points])
        self._law, self._path = _linear(self._knots_s, positions)
        if trajectory.interpolation is Interpolation.CATMULL_ROM and len(points) > 2:
            _bend(self._knots_s, positions, self._law, self._path)

    def positions(self, times_s: ArrayLike) -> Floats:
        """Return the positions at one or more times, s, in metres, shape (n, 3)."""
        segments, local_s = self._locate(np.atleast_1d(np.asarray(times_s, dtype=np.float64)))
        return _value(self._path[segments], _value(self._law[segments], local_s)[:, None])

    def sample(self, times_s: ArrayLike) -> Samples:
        """Return poses and rates at one or more times, s; before the start and after the end, rates are zero."""
        from scipy.spatial.transform import Rotation

        times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
        segments, local_s = self._locate(times)
        law, path = self._law[segments], self._path[segments]
        share, rate = (_value(law, local_s, order)[:, None] for order in (0, 1))
        rate[(times < self.times_s[0]) | (times > self.times_s[-1])] = 0.0
        turned = Rotation.from_rotvec(self._turns[segments] * share)
        return Samples(
            times_s=times,
            positions_m=_value(path, share),
            quats_xyzw=(turned * self._rotations[segments]).as_quat(),
            velocities_m_s=_value(path, share, 1) * rate,
            angular_rad_s=self._turns[segments] * rate,
        )

    def _locate(self, times_s: Floats) -> tuple[NDArray[np.intp], Floats]:
        """Return the segments of times, and the times since the starts of these."""
        last = len(self._law) - 1
        segments = np.clip(np.searchsorted(self._knots_s, times_s, side="right") - 1, 0, last)
        durations = np.diff(self._knots_s)[segments]
        return segments, np.clip(times_s - self._knots_s[segments], 0.0, durations)


@functools.lru_cache(maxsize=256)
def motion_of(trajectory: Trajectory) -> Motion:
    """Return the polynomials of a trajectory; equal trajectories share them."""
    return Motion(trajectory)


def sample(trajectory: Trajectory, times_s: ArrayLike) -> Samples:
    """Return the poses and rates of a trajectory at one or more times, shape (n,), s."""
    return motion_of(trajectory).sample(times_s)


def pose_at(trajectory: Trajectory, time_s: float) -> Pose:
    """Return the pose of a trajectory at a time, s."""
    return sample(trajectory, time_s).pose(0)


def resampled(trajectory: Trajectory, period_ns: int) -> Trajectory:
    """Return a polyline through the waypoints of a trajectory, with one at least every `period_ns`."""
    times_ns = [trajectory.start_ns]
    for before, after in pairwise(trajectory.waypoints):
        times_ns += range(before.time_ns + period_ns, after.time_ns, period_ns)
        times_ns.append(after.time_ns)
    found = sample(trajectory, np.array(times_ns) / NS_PER_S)
    waypoints = []
    for index, time_ns in enumerate(times_ns):
        waypoints.append((time_ns, found.pose(index)))
    return Trajectory.of(waypoints)


def _linear(times_s: Floats, positions_m: Floats) -> tuple[Floats, Floats]:
    """Return law (n - 1, 4) and path (n - 1, 4, 3) of a polyline, lowest power first."""
    law = np.zeros((len(times_s) - 1, 4))
    law[:, 1] = 1.0 / np.diff(times_s)
    path = np.zeros((len(times_s) - 1, 4, 3))
    path[:, 0] = positions_m[:-1]
    path[:, 1] = np.diff(positions_m, axis=0)
    return law, path


def _bend(times_s: Floats, positions_m: Floats, law: Floats, path: Floats) -> None:
    """Replace law and path of a polyline by those of the spline, where something moves."""
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    place = _places(positions_m)
    points = positions_m[np.unique(place, return_index=True)[1]]
    if len(points) < 2:
        return
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    knots = np.concatenate([[0.0], np.cumsum(lengths**_ALPHA)])
    curve = CubicHermiteSpline(knots, points, _tangents(knots, points)).c[::-1]
    drive = PchipInterpolator(times_s, knots[place]).c[::-1]
    moving = np.flatnonzero(np.diff(place))
    step = np.diff(knots)[place[moving]]
    law[moving] = (drive[:, moving] / step).T
    law[moving, 0] = 0.0
    powers = step[:, None] ** np.arange(4)
    path[moving] = np.moveaxis(curve[:, place[moving]], 0, 1) * powers[:, :, None]


def _places(positions_m: Floats) -> NDArray[np.intp]:
    """Return for each waypoint the number of its place; waypoints in a row at one place share it."""
    place, last = [0], positions_m[0]
    for position in positions_m[1:]:
        moved = bool(np.linalg.norm(position - last) > _TOGETHER_M)
        if moved:
            last = position
        place.append(place[-1] + moved)
    return np.array(place)


def _tangents(knots: Floats, points: Floats) -> Floats:
    """Return dP/du at each point, as in Barry and Goldman's pyramid; at the ends it is the chord."""
    steps = np.diff(knots)[:, None]
    chords = np.diff(points, axis=0) / steps
    tangents = np.empty_like(points)
    tangents[0], tangents[-1] = chords[0], chords[-1]
    before, after = steps[:-1], steps[1:]
    tangents[1:-1] = (chords[:-1] * after + chords[1:] * before) / (before + after)
    return tangents


def _value(coefficients: Floats, at: Floats, derivative: int = 0) -> Floats:
    """Return cubics or their first derivatives with Horner's rule: coefficients (n, 4, ...), lowest power first."""
    value: Floats | float = 0.0
    for power in range(3, derivative - 1, -1):
        factor = power if derivative else 1
        value = value * at + factor * coefficients[:, power]
    return np.asarray(value)
