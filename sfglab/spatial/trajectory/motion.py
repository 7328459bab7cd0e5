"""Motion between waypoints: positions, orientations and their rates at any time, for whole arrays of times.

Every segment is a path P(g) with g from 0 to 1, driven by a law g(t); both are cubics.

- Polyline: P linear, g linear in time (paper A, section 4.5).
- Centripetal Catmull-Rom: P is the Barry-Goldman pyramid's cubic, knots u_(i+1) - u_i = |p_(i+1) - p_i|^0.5;
  the phantom points before the first and after the last are mirrored. u(t) is the monotone cubic through
  (t_i, u_i), so that the velocity is continuous, nobody drives backwards, and a wait (two waypoints at one
  place) begins and ends at rest. The path does not depend on times, and re-timing keeps it.
- Orientation: SLERP with the same g. Squad would make the angular velocity continuous too, but it leaves the
  arc between its neighbours, and how far depends on them; SLERP's rates have a closed form, which limits need.

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
from sfglab.spatial.trajectory.path import Interpolation, Trajectory, Waypoint
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]


_TOGETHER_M = 1e-9  #: Waypoints of a spline that are closer than this are one place.
_ALPHA = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """A trajectory at n times."""

    times_s: Floats  #: When, shape (n,).
    positions_m: Floats  #: Shape (n, 3).
    quats_xyzw: Floats  #: Shape (n, 4); a sign says nothing.
    velocities_m_s: Floats  #: Shape (n, 3); at a waypoint, of the segment that leaves.
    accelerations_m_s2: Floats  #: Shape (n, 3); zero in a polyline, whose corners are for `limits`.
    angular_rad_s: Floats  #: Angular velocity in the fixed frame, shape (n, 3).

    @property
    def speeds_m_s(self) -> Floats:
        """Lengths of the velocities, shape (n,)."""
        return np.asarray(np.linalg.norm(self.velocities_m_s, axis=1))

    @property
    def yaw_rates_rad_s(self) -> Floats:
        """Angular velocity about the fixed z axis, shape (n,)."""
        return self.angular_rad_s[:, 2]

    def pose(self, index: int) -> Pose:
        """Return one of the poses."""
        position, quat = self.positions_m[index].tolist(), self.quats_xyzw[index].tolist()
        return Pose.at(position, quat, place=f"sample {index}")


class Motion:
    """The segments of a trajectory, of one waypoint or more, as polynomials; `motion_of` keeps those in use."""

    def __init__(self, trajectory: Trajectory) -> None:
        from scipy.spatial.transform import Rotation

        poses = [w.pose for w in trajectory.waypoints]
        #: Shape (n,).
        self.times_s = np.array([w.time_ns for w in trajectory.waypoints]) / NS_PER_S
        #: Their positions, shape (n, 3).
        self.positions_m = np.array([p.position_m for p in poses])
        self._rotations = Rotation.from_quat([p.quat_xyzw for p in poses])
        several = len(poses) > 1
        turns = (
            (self._rotations[1:] * self._rotations[:-1].inv()).as_rotvec()
            if several
            else np.empty((0, 3))
        )
        self._turns = np.asarray(turns, dtype=np.float64)
        #: Each segment's position is linear in time.
        self.exact = trajectory.interpolation is Interpolation.POLYLINE or len(poses) < 3
        self.durations_s = np.diff(self.times_s)
        laws = _linear(self.times_s, self.positions_m)
        self._law, self._path = (
            laws if self.exact else _catmull_rom(self.times_s, self.positions_m, laws)
        )

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.durations_s)

    def positions(self, times_s: ArrayLike) -> Floats:
        """Return positions at any times, shape (n, 3); before the start and after the end one stands."""
        segments, local_s = self._locate(np.atleast_1d(np.asarray(times_s, dtype=np.float64)))
        if not len(self):
            return np.repeat(self.positions_m, len(local_s), axis=0)
        return _value(self._path[segments], _value(self._law[segments], local_s)[:, None])

    def sample(self, times_s: ArrayLike) -> Samples:
        """Return everything at any times; before the start and after the end one stands."""
        times = np.atleast_1d(np.asarray(times_s, dtype=np.float64))
        segments, local_s = self._locate(times)
        if not len(self):
            return self._stand(times)
        position, velocity, acceleration, angular = self.rates(segments, local_s)
        still = (times < self.times_s[0]) | (times > self.times_s[-1])
        for rate in (velocity, acceleration, angular):
            rate[still] = 0.0
        return Samples(
            times_s=times,
            positions_m=position,
            quats_xyzw=self._orientations(segments, local_s),
            velocities_m_s=velocity,
            accelerations_m_s2=acceleration,
            angular_rad_s=angular,
        )

    def rates(
        self, segments: NDArray[np.intp], local_s: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return position, velocity, acceleration and angular velocity inside segments, indices of shape (n,).

        Times are since each one's start, shape (n,); a segment's end is its own here, not the next one's start.
        """
        law, path = self._law[segments], self._path[segments]
        g, g1, g2 = (_value(law, local_s, order)[:, None] for order in range(3))
        p, p1, p2 = (_value(path, g, order) for order in range(3))
        return p, p1 * g1, p2 * g1**2 + p1 * g2, self._turns[segments] * g1

    def bend_bounds_m_s2(self) -> Floats:
        """Return a bound of the acceleration's length in every segment, shape (n - 1,).

        From Bézier control points, within whose hull a polynomial stays: |a| <= |P''| g'^2 + |P'| |g''|.
        """
        path1, law1 = _bezier_of_slope(self._path), _bezier_of_slope(self._law)
        speed = np.linalg.norm(path1, axis=2).max(axis=1)
        bend = np.linalg.norm(np.diff(path1, axis=1), axis=2).max(axis=1) * 2.0
        dt = self.durations_s
        # the law's cubic is in seconds; in parts of its segment its slope is dt times as large
        law1 = _bezier_of_slope(self._law * (dt[:, None] ** np.arange(4)))
        slope = np.abs(law1).max(axis=1) / dt
        jerk = np.abs(np.diff(law1, axis=1)).max(axis=1) * 2.0 / dt**2
        return np.asarray(bend * slope**2 + speed * jerk)

    def boxes_m(self) -> tuple[Floats, Floats]:
        """Return least and greatest x, y, z of every segment, each (n - 1, 3); of the position without any."""
        if not len(self):
            return self.positions_m, self.positions_m
        a, b, c, d = (self._path[:, power] for power in range(4))
        points = np.stack([a, a + b / 3, a + 2 * b / 3 + c / 3, a + b + c + d])
        return points.min(axis=0), points.max(axis=0)

    def _locate(self, times_s: Floats) -> tuple[NDArray[np.intp], Floats]:
        last = max(len(self) - 1, 0)
        segments = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, last)
        if not len(self):
            return segments, np.zeros_like(times_s)
        return segments, np.clip(times_s - self.times_s[segments], 0.0, self.durations_s[segments])

    def _orientations(self, segments: NDArray[np.intp], local_s: Floats) -> Floats:
        from scipy.spatial.transform import Rotation

        turned = self._turns[segments] * _value(self._law[segments], local_s)[:, None]
        quats: Floats = (Rotation.from_rotvec(turned) * self._rotations[segments]).as_quat()
        return quats

    def _stand(self, times_s: Floats) -> Samples:
        count = len(times_s)
        return Samples(
            times_s=times_s,
            positions_m=np.repeat(self.positions_m, count, axis=0),
            quats_xyzw=np.repeat(self._rotations.as_quat().reshape(1, 4), count, axis=0),
            velocities_m_s=np.zeros((count, 3)),
            accelerations_m_s2=np.zeros((count, 3)),
            angular_rad_s=np.zeros((count, 3)),
        )


@functools.lru_cache(maxsize=256)
def motion_of(trajectory: Trajectory) -> Motion:
    """Return a trajectory's polynomials; equal trajectories share them."""
    return Motion(trajectory)


def sample(trajectory: Trajectory, times_s: ArrayLike) -> Samples:
    """Return poses and rates at one time or several, shape (n,), in seconds; beyond its ends one stands."""
    return motion_of(trajectory).sample(times_s)


def pose_at(trajectory: Trajectory, time_s: float) -> Pose:
    """Return the pose at one time."""
    return sample(trajectory, time_s).pose(0)


def resampled(trajectory: Trajectory, period_ns: int) -> Trajectory:
    """Return a polyline that meets a trajectory at its own waypoints and at least every `period_ns`."""
    grid: list[Waypoint] = []
    points = trajectory.waypoints
    for before, after in pairwise(points):
        inner = range(before.time_ns + period_ns, after.time_ns, period_ns)
        found = sample(trajectory, np.array(inner) / NS_PER_S) if inner else None
        more = ((time_ns, found.pose(i)) for i, time_ns in enumerate(inner)) if found else ()
        grid += [before, *Trajectory.of(more).waypoints] if found else [before]
    return Trajectory(waypoints=(*grid, points[-1]))


def _linear(times_s: Floats, positions_m: Floats) -> tuple[Floats, Floats]:
    """Return law (n - 1, 4) and path (n - 1, 4, 3) of a polyline, lowest power first."""
    law = np.zeros((len(times_s) - 1, 4))
    law[:, 1] = 1.0 / np.diff(times_s)
    path = np.zeros((len(times_s) - 1, 4, 3))
    path[:, 0], path[:, 1] = positions_m[:-1], np.diff(positions_m, axis=0)
    return law, path


def _catmull_rom(
    times_s: Floats, positions_m: Floats, linear: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return law and path of the spline; where nobody moves, those of the polyline stay."""
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    law, path = linear
    place = _places(positions_m)
    points = positions_m[np.unique(place, return_index=True)[1]]
    if len(points) < 2:
        return law, path
    knots = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) ** _ALPHA)]
    )
    curve = CubicHermiteSpline(knots, points, _tangents(knots, points)).c[::-1]
    drive = PchipInterpolator(times_s, knots[place]).c[::-1]
    moving = np.flatnonzero(np.diff(place))
    step = np.diff(knots)[place[moving]]
    law[moving] = (drive[:, moving] / step).T
    law[moving, 0] = 0.0
    path[moving] = (
        np.moveaxis(curve[:, place[moving]], 0, 1) * (step[:, None] ** np.arange(4))[:, :, None]
    )
    return law, path


def _places(positions_m: Floats) -> NDArray[np.intp]:
    """Return for every waypoint which place in a row it is; those at one place share it."""
    place, last, count = [0], positions_m[0], 0
    for position in positions_m[1:]:
        if np.linalg.norm(position - last) > _TOGETHER_M:
            last, count = position, count + 1
        place.append(count)
    return np.array(place)


def _tangents(knots: Floats, points: Floats) -> Floats:
    """Return dP/du at every point as the Barry-Goldman pyramid has it; at the ends it is the chord."""
    steps = np.diff(knots)[:, None]
    chords = np.diff(points, axis=0) / steps
    tangents = np.empty_like(points)
    tangents[0], tangents[-1] = chords[0], chords[-1]
    before, after = steps[:-1], steps[1:]
    tangents[1:-1] = (chords[:-1] * after + chords[1:] * before) / (before + after)
    return tangents


def _value(coefficients: Floats, at: Floats, order: int = 0) -> Floats:
    """Return cubics, or derivatives of them, by Horner's rule: coefficients (n, 4, ...), lowest power first."""
    factor = np.arange(4.0)
    value: Floats | float = 0.0
    for power in range(3, order - 1, -1):
        weight = np.prod(factor[power - order + 1 : power + 1]) if order else 1.0
        value = value * at + weight * coefficients[:, power]
    return np.asarray(value)


def _bezier_of_slope(coefficients: Floats) -> Floats:
    """Return the three control points of cubics' derivatives over 0 to 1, shape (n, 3, ...)."""
    a, b, c = (power * coefficients[:, power] for power in (1, 2, 3))
    return np.stack([a, a + b / 2, a + b + c], axis=1)
