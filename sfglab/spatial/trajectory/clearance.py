"""Distances of agents to each other and to solid bodies, in space and time.

Bodies are convex and stand in their own frames, centred; z is a cylinder's axis. Polylines are exact: between
two waypoint times the relative motion is linear, the closest point of a line to the origin has a closed form,
and the distance to a convex body is convex along a line. A spline is left by a chord over h by at most h^2 / 8
max |a|, with the bound of `Motion`; chords are split until that is below half the tolerance where it matters,
and what was found is then sharpened on the curve itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from sfglab.spatial.trajectory.motion import Motion, motion_of
from sfglab.spatial.trajectory.path import Trajectory, TrajectoryError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

    from sfglab.spatial.poses import Pose, Vec3


class _Body:
    __slots__ = ()

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):  # type: ignore[arg-type]
            for size in np.atleast_1d(getattr(self, name)):
                if not 0.0 < size < math.inf:
                    raise TrajectoryError(name, getattr(self, name), "finite numbers above zero")


@dataclass(frozen=True, slots=True, kw_only=True)
class Box(_Body):
    """A box."""

    size_m: tuple[float, float, float]  #: Lengths along x, y and z.

    @property
    def reach_m(self) -> float:
        """How far its farthest point is from its centre."""
        return math.hypot(*self.size_m) / 2.0

    def distances_m(self, points_m: Floats) -> Floats:
        """Return distances of points, shape (n, 3), to the surface; negative inside."""
        return _hull(np.abs(points_m) - np.array(self.size_m) / 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(_Body):
    """A sphere."""

    radius_m: float  #: Its radius.

    @property
    def reach_m(self) -> float:
        """How far its farthest point is from its centre."""
        return self.radius_m

    def distances_m(self, points_m: Floats) -> Floats:
        """Return distances of points, shape (n, 3), to the surface; negative inside."""
        return np.asarray(np.linalg.norm(points_m, axis=1) - self.radius_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder(_Body):
    """A cylinder, upright along z."""

    radius_m: float  #: Its radius.
    height_m: float  #: Its height, half of it below the centre.

    @property
    def reach_m(self) -> float:
        """How far its farthest point is from its centre."""
        return math.hypot(self.radius_m, self.height_m / 2.0)

    def distances_m(self, points_m: Floats) -> Floats:
        """Return distances of points, shape (n, 3), to the surface; negative inside."""
        beside = np.hypot(points_m[:, 0], points_m[:, 1]) - self.radius_m
        above = np.abs(points_m[:, 2]) - self.height_m / 2.0
        return _hull(np.stack([beside, above], axis=1))


Shape = Box | Sphere | Cylinder


def _hull(beyond: Floats) -> Floats:
    """Return the distance to a product of intervals, given how far one is beyond each of them."""
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))


#: How far a spline's closest distance may be above the true one, unless asked otherwise.
TOLERANCE_M = 1e-4
_PARTS = 4
_SPLITS = 12
_ROUNDING_M = 1e-12
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_ROUNDS = 60
_ROUNDS_ON_CURVES = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """The moment at which two agents are closest; the first of several equal ones."""

    time_s: float  #: When.
    distance_m: float  #: Between their centres.
    position_a_m: Vec3  #: Where the first is then.
    position_b_m: Vec3  #: Where the second is then.
    tolerance_m: float  #: The true least distance is at most this much smaller; 0 for polylines.


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleApproach:
    """The moment at which an agent is closest to a body, or deepest inside."""

    time_s: float  #: When.
    clearance_m: float  #: Between the agent's centre and the surface; negative inside.
    position_m: Vec3  #: Where the agent's centre is then.
    tolerance_m: float  #: The true least clearance is at most this much smaller; 0 for polylines.


def closest_approach(a: Trajectory, b: Trajectory, *, tolerance_m: float = TOLERANCE_M) -> Approach:
    """Return when and where two in one frame are closest, up to `tolerance_m` for splines; ends stand."""
    one, other = motion_of(a), motion_of(b)
    start_s = float(min(one.times_s[0], other.times_s[0]))
    end_s = float(max(one.times_s[-1], other.times_s[-1]))

    def relative(at_s: Floats) -> Floats:
        return one.positions(at_s) - other.positions(at_s)

    chords = _chords((one, other), start_s, end_s)
    time_s, off_m = _least(chords, relative, _OriginMinimum(), tolerance_m / 2.0)
    return Approach(
        time_s=time_s,
        distance_m=float(np.linalg.norm(relative(np.array([time_s])))),
        position_a_m=_position(a, time_s),
        position_b_m=_position(b, time_s),
        tolerance_m=2.0 * off_m,
    )


def closest_to_shape(
    trajectory: Trajectory, shape: Shape, shape_pose: Pose, *, tolerance_m: float = TOLERANCE_M
) -> ObstacleApproach:
    """Return when and where one is closest to a body, or deepest inside, up to `tolerance_m` for splines."""
    motion = motion_of(trajectory)
    turned = shape_pose.rotation.inv()

    def relative(at_s: Floats) -> Floats:
        inside: Floats = turned.apply(motion.positions(at_s) - shape_pose.position_m)
        return inside

    chords = _chords((motion,), float(motion.times_s[0]), float(motion.times_s[-1]))
    time_s, off_m = _least(chords, relative, _ShapeMinimum(shape), tolerance_m / 2.0)
    return ObstacleApproach(
        time_s=time_s,
        clearance_m=float(shape.distances_m(relative(np.array([time_s])))[0]),
        position_m=_position(trajectory, time_s),
        tolerance_m=2.0 * off_m,
    )


def _position(trajectory: Trajectory, time_s: float) -> Vec3:
    x, y, z = motion_of(trajectory).positions(time_s)[0].tolist()
    return (x, y, z)


class _Chords(NamedTuple):
    """Intervals of time, and how much a motion bends in each; all of shape (n,)."""

    start_s: Floats
    end_s: Floats
    bend_m_s2: Floats

    @property
    def off_m(self) -> Floats:
        """How far the motion can be from its chord."""
        return (self.end_s - self.start_s) ** 2 * self.bend_m_s2 / 8.0

    def only(self, which: NDArray[np.bool_]) -> _Chords:
        return _Chords(self.start_s[which], self.end_s[which], self.bend_m_s2[which])

    def split(self) -> _Chords:
        edges = np.linspace(self.start_s, self.end_s, _PARTS + 1, axis=1)
        return _Chords(
            edges[:, :-1].ravel(), edges[:, 1:].ravel(), np.repeat(self.bend_m_s2, _PARTS)
        )


class _Minimum(Protocol):
    """How close points and straight lines come to something; shares are parts of a line, 0 to 1."""

    def distances(self, points_m: Floats) -> Floats: ...

    def bounds(self, start_m: Floats, end_m: Floats) -> Floats: ...

    def shares(self, start_m: Floats, end_m: Floats) -> Floats: ...


class _OriginMinimum:
    """To the origin, in closed form."""

    def distances(self, points_m: Floats) -> Floats:
        return np.asarray(np.linalg.norm(points_m, axis=1))

    def bounds(self, start_m: Floats, end_m: Floats) -> Floats:
        share = self.shares(start_m, end_m)[:, None]
        return self.distances((1.0 - share) * start_m + share * end_m)

    def shares(self, start_m: Floats, end_m: Floats) -> Floats:
        way = end_m - start_m
        square = np.einsum("ij,ij->i", way, way)
        along = -np.einsum("ij,ij->i", start_m, way) / np.where(square > 0.0, square, 1.0)
        return np.asarray(np.clip(along, 0.0, 1.0))


class _ShapeMinimum:
    """To a body, in its frame."""

    def __init__(self, shape: Shape) -> None:
        self.distances = shape.distances_m

    def bounds(self, start_m: Floats, end_m: Floats) -> Floats:
        """Return what no point of a line is below: distances change by a metre a metre."""
        ends = self.distances(start_m) + self.distances(end_m)
        return np.asarray((ends - np.linalg.norm(end_m - start_m, axis=1)) / 2.0)

    def shares(self, start_m: Floats, end_m: Floats) -> Floats:
        def gap(share: Floats) -> Floats:
            return self.distances((1.0 - share[:, None]) * start_m + share[:, None] * end_m)

        return _narrowed(np.zeros(len(start_m)), np.ones(len(start_m)), gap)


def _chords(motions: tuple[Motion, ...], start_s: float, end_s: float) -> _Chords:
    """Return the intervals between anybody's waypoints, with the sum of all accelerations' bounds."""
    edges = np.concatenate([motion.times_s for motion in motions])
    edges = np.unique(
        np.concatenate([[start_s, end_s], edges[(edges > start_s) & (edges < end_s)]])
    )
    if len(edges) == 1:
        edges = np.repeat(edges, 2)
    middle = (edges[:-1] + edges[1:]) / 2.0
    bends = np.zeros(len(middle))
    for motion in motions:
        if motion.exact:
            continue
        inside = (middle > motion.times_s[0]) & (middle < motion.times_s[-1])
        segment = np.searchsorted(motion.times_s, middle[inside], side="right") - 1
        bends[inside] += motion.bend_bounds_m_s2()[segment]
    return _Chords(edges[:-1], edges[1:], bends)


def _least(
    chords: _Chords, relative: Callable[[Floats], Floats], lines: _Minimum, off_m: float
) -> tuple[float, float]:
    """Return when something is closest, and how far it is at most from the chords that show it.

    Chords that can hold nothing closer are dropped; the others are split until they are close enough.
    """
    best_m = math.inf
    for _ in range(_SPLITS):
        start_m, end_m = relative(chords.start_s), relative(chords.end_s)
        best_m = min(best_m, float(lines.distances(np.concatenate([start_m, end_m])).min()))
        kept = lines.bounds(start_m, end_m) - chords.off_m <= best_m + _ROUNDING_M
        start_m, end_m, chords = start_m[kept], end_m[kept], chords.only(kept)
        coarse = chords.off_m > off_m
        if not coarse.any():
            break
        both = chords.only(~coarse), chords.only(coarse).split()
        chords = _Chords(*map(np.concatenate, zip(*both, strict=True)))
    start_m, end_m = relative(chords.start_s), relative(chords.end_s)
    share = lines.shares(start_m, end_m)
    tried = np.concatenate(
        [chords.start_s + share * (chords.end_s - chords.start_s), chords.start_s, chords.end_s]
    )
    left_m = float(chords.off_m.max())
    if left_m:
        tried = np.append(tried, _sharpened(chords, lambda at_s: lines.distances(relative(at_s))))
    tried = np.sort(tried)
    return float(tried[lines.distances(relative(tried)).argmin()]), left_m


def _narrowed(
    low: Floats, high: Floats, gap: Callable[[Floats], Floats], *, rounds: int = _ROUNDS
) -> Floats:
    """Return where functions that fall and then rise are least, by golden sections, all at once."""
    for _ in range(rounds):
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        falling = gap(left) > gap(right)
        low, high = np.where(falling, left, low), np.where(falling, high, right)
    return (low + high) / 2.0


def _sharpened(chords: _Chords, gap: Callable[[Floats], Floats]) -> Floats:
    """Return where a curve's distance is least inside the most promising of its chords."""
    first = np.argsort(np.minimum(gap(chords.start_s), gap(chords.end_s)))[:_PARTS]
    return _narrowed(chords.start_s[first], chords.end_s[first], gap, rounds=_ROUNDS_ON_CURVES)
