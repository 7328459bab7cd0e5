"""Checks of drawn trajectories: headings, interpolation, re-timing and clearance; paper A, section 4.5."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.checks import Checks
from sfglab.spatial import Pose
from sfglab.spatial.trajectory.clearance import closest_approach
from sfglab.spatial.trajectory.limits import Limits, limit_violations, retimed
from sfglab.spatial.trajectory.motion import motion_of, pose_at, resampled, sample
from sfglab.spatial.trajectory.path import (
    Align,
    Interpolation,
    Trajectory,
    align_waypoint,
    in_frame,
    stretched,
)
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Trial = Callable[[np.random.Generator], str]
    Floats = NDArray[np.float64]

checks = Checks("geometry")
#: What must fail now and then: it shows what the check for loops can see.
contrast = Checks("contrast")

EITHER = tuple(Interpolation)
_REACH_M = 5.0
_WAIT = 0.15  #: Share of waypoints that stand where the one before stands.


def random_pose(rng: np.random.Generator) -> Pose:
    """Return a pose within some metres, turned in any way."""
    return Pose.at(rng.uniform(-_REACH_M, _REACH_M, 3), rng.normal(size=4))


def random_trajectory(
    rng: np.random.Generator, *, least: int = 2, kinds: tuple[Interpolation, ...] = EITHER
) -> Trajectory:
    """Return a trajectory with dense and far apart times, turns on the spot, and any interpolation."""
    time_ns, found = int(rng.integers(0, 5 * NS_PER_S)), [random_pose(rng)]
    times = [time_ns]
    for _ in range(int(rng.integers(least, 8)) - 1):
        time_ns += round(
            NS_PER_S * float(rng.choice([0.05, 0.5, 1.0, 3.0])) * rng.uniform(0.5, 2.0)
        )
        times.append(time_ns)
        there = random_pose(rng)
        waits = rng.random() < _WAIT
        found.append(Pose.at(found[-1].position_m, there.quat_xyzw) if waits else there)
    return Trajectory.of(zip(times, found, strict=True), kinds[int(rng.integers(len(kinds)))])


def random_limits(rng: np.random.Generator) -> Limits:
    """Return limits, one of them missing now and then."""
    drawn = (None if rng.random() < 0.1 else float(rng.uniform(0.3, 3.0)) for _ in range(3))
    speed, acceleration, yaw_rate = drawn
    return Limits(speed_m_s=speed, acceleration_m_s2=acceleration, yaw_rate_rad_s=yaw_rate)


_SPLINE, _LINE = (Interpolation.CATMULL_ROM,), (Interpolation.POLYLINE,)
_NEAR_M, _NEAR_RAD = 1e-9, 1e-6
_TWO_WAYS_RAD = 3.1  #: Beyond this, two turns are nearly as short, and rounding chooses.
_HALF_TURN_SHARE = 1e-6


def _said(problem: bool, text: str) -> str:  # noqa: FBT001 - the one thing that it is about
    return text if problem else ""


@checks.trial("a trajectory is at every waypoint at its time")
def _waypoints_are_met(rng: np.random.Generator) -> str:
    path = random_trajectory(rng)
    found = sample(path, [w.time_ns / NS_PER_S for w in path.waypoints])
    off = [
        i
        for i, w in enumerate(path.waypoints)
        if not found.pose(i).same_as(w.pose, within_rad=_NEAR_RAD)
    ]
    return _said(bool(off), f"{path.interpolation.value}: waypoint {off}")


@checks.trial("every pose between is a rigid motion")
def _poses_are_rigid(rng: np.random.Generator) -> str:
    path = random_trajectory(rng)
    times = np.linspace(path.start_ns / NS_PER_S - 1, path.end_ns / NS_PER_S + 1, 50)
    matrices = [sample(path, times).pose(i).matrix()[:3, :3] for i in range(len(times))]
    worst = max(float(np.abs(m @ m.T - np.eye(3)).max()) for m in matrices)
    return _said(
        worst > 1e-12 or min(map(np.linalg.det, matrices)) < 0.5, f"not orthogonal by {worst:.1g}"
    )


@checks.trial("a polyline is linear in position and SLERP in orientation")
def _polyline_is_slerp(rng: np.random.Generator) -> str:
    path = random_trajectory(rng, kinds=_LINE)
    for before, after in pairwise(path.waypoints):
        share = float(rng.uniform())
        time_ns = before.time_ns + share * (after.time_ns - before.time_ns)
        found, wanted = (
            pose_at(path, time_ns / NS_PER_S),
            before.pose.interpolate(after.pose, share),
        )
        two_ways = before.pose.angle_rad(after.pose) > _TWO_WAYS_RAD
        if found.distance_m(wanted) > 1e-6 or (not two_ways and found.angle_rad(wanted) > 1e-5):
            return f"{found} instead of {wanted}"
    return ""


@checks.trial("interpolating and moving to another frame commute")
def _frames_commute(rng: np.random.Generator) -> str:
    path, frame = random_trajectory(rng), random_pose(rng)
    while any(a.pose.angle_rad(b.pose) > _TWO_WAYS_RAD for a, b in pairwise(path.waypoints)):
        path = random_trajectory(rng)
    times = np.linspace(path.start_ns, path.end_ns, 15) / NS_PER_S
    here, there = sample(path, times), sample(in_frame(path, frame), times)
    for i, time_s in enumerate(times):
        if not (frame @ here.pose(i)).same_as(there.pose(i), within_m=1e-6, within_rad=1e-5):
            return f"{path.interpolation.value}: time {time_s:.3f} s"
    return ""


def _headings_follow(align: Align) -> Trial:
    def trial(rng: np.random.Generator) -> str:
        path = random_trajectory(rng)
        index = int(rng.integers(len(path.waypoints)))
        turned = align_waypoint(path, index, align).waypoints[index].pose
        start = index - 1 if align is Align.PREVIOUS else index
        start = min(max(start, 0), len(path.waypoints) - 2)
        a, b = (np.array(path.waypoints[i].pose.position_m) for i in (start, start + 1))
        way = b - a
        if math.hypot(way[0], way[1]) < 1e-6:
            return _said(
                turned != path.waypoints[index].pose, "it turned where there is no heading"
            )
        x_axis, y_axis = turned.matrix()[:3, 0], turned.matrix()[:3, 1]
        off = float(np.linalg.norm(x_axis - way / np.linalg.norm(way)))
        return _said(
            off > 1e-9 or abs(y_axis[2]) > 1e-12, f"x axis off by {off:.1g}, roll {y_axis[2]:.1g}"
        )

    return trial


checks.trial(
    "aligned to the previous waypoint, x looks along the segment that arrives, without roll"
)(_headings_follow(Align.PREVIOUS))
checks.trial("aligned to the next waypoint, x looks along the segment that leaves, without roll")(
    _headings_follow(Align.NEXT)
)


def _pyramid(points: Floats, share: float) -> Floats:
    """Return a point of the segment between the second and third of four, by Barry and Goldman's pyramid."""
    knots = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) ** 0.5)]
    )
    u, level = knots[1] + share * (knots[2] - knots[1]), list(points)
    for height in (1, 2):
        level = [
            ((knots[i + height] - u) * level[i] + (u - knots[i]) * level[i + 1])
            / (knots[i + height] - knots[i])
            for i in range(4 - height)
        ]
    return np.asarray(
        ((knots[2] - u) * level[0] + (u - knots[1]) * level[1]) / (knots[2] - knots[1])
    )


def _timed_by_knots(points: Floats) -> Trajectory:
    """Return the spline through points at times that grow as its knots do, so that it is a cubic in time."""
    knots = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) ** 0.5)]
    )
    pairs = ((round(u * NS_PER_S), Pose.at(p)) for u, p in zip(knots, points, strict=True))
    return Trajectory.of(pairs, Interpolation.CATMULL_ROM)


@checks.trial("a spline is Barry and Goldman's pyramid with centripetal knots")
def _spline_is_the_pyramid(rng: np.random.Generator) -> str:
    points = rng.uniform(-5, 5, (4, 3))
    path = _timed_by_knots(points)
    start, end = (path.waypoints[i].time_ns / NS_PER_S for i in (1, 2))
    share = float(rng.uniform())
    found = motion_of(path).positions(start + share * (end - start))[0]
    off = float(np.linalg.norm(found - _pyramid(points, share)))
    return _said(off > 1e-6, f"off by {off:.1g} m")


@checks.trial("a spline's velocity does not jump at waypoints")
def _velocity_is_continuous(rng: np.random.Generator) -> str:
    motion = motion_of(random_trajectory(rng, least=3, kinds=_SPLINE))
    ends = np.arange(len(motion) - 1)
    before = motion.rates(ends, motion.durations_s[ends])[1]
    after = motion.rates(ends + 1, np.zeros(len(ends)))[1]
    jump = float(np.abs(before - after).max())
    return _said(jump > 1e-6 * max(1.0, float(np.abs(before).max())), f"jumps by {jump:.1g} m/s")


@checks.trial("a spline along a line never goes back")
def _no_overshoot(rng: np.random.Generator) -> str:
    """On a straight line: waypoints that advance, by 1 cm to 10 m each, and a spline that never goes back."""
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    along = np.cumsum(10.0 ** rng.uniform(-2, 1, int(rng.integers(3, 8))))
    times = np.cumsum(rng.integers(1, 3 * NS_PER_S, len(along)))
    places = ((int(t), Pose.at(s * way)) for t, s in zip(times, along, strict=True))
    path = Trajectory.of(places, Interpolation.CATMULL_ROM)
    found = sample(path, np.linspace(path.start_ns, path.end_ns, 500) / NS_PER_S)
    back = float((found.velocities_m_s @ way).min())
    return _said(back < -1e-9 * float(found.speeds_m_s.max()), f"goes back at {-back:.1g} m/s")


def planar_curve(points: Floats) -> Floats:
    """Return the cubics of a driven spline, shape (n - 1, 4, 2), lowest power first, each over 0 to 1."""
    path = _timed_by_knots(np.column_stack([points, np.zeros(len(points))]))
    motion, shares = motion_of(path), np.array([0.0, 1 / 3, 2 / 3, 1.0])
    powers = np.vander(shares, 4, increasing=True)
    places = (motion.positions(a + shares * (b - a))[:, :2] for a, b in pairwise(motion.times_s))
    return np.array([np.linalg.solve(powers, place) for place in places])


def uniform_curve(points: Floats) -> Floats:
    """Return the same for evenly spaced knots, the first form of Catmull and Rom, which does make loops."""
    padded = np.vstack([2 * points[0] - points[1], points, 2 * points[-1] - points[-2]])
    slopes = (padded[2:] - padded[:-2]) / 2.0
    a, b, va, vb = points[:-1], points[1:], slopes[:-1], slopes[1:]
    return np.stack([a, va, 3 * (b - a) - 2 * va - vb, 2 * (a - b) + va + vb], axis=1)


def scattered(rng: np.random.Generator) -> Floats:
    """Return five points of the plane, near and far apart."""
    return np.asarray(rng.normal(size=(5, 2)) * 10.0 ** rng.uniform(-1, 1, (5, 1)))


@contrast.trial("with evenly spaced knots instead, there would be no loop")
def uniform_has_no_loop(rng: np.random.Generator) -> str:
    """Say where evenly spaced knots make a loop: the contrast that shows what the check can see."""
    return _looped(uniform_curve, rng)


def _looped(curve: Callable[[Floats], Floats], rng: np.random.Generator) -> str:
    points = scattered(rng)
    bad = [i for i, cubic in enumerate(curve(points)) if loops(cubic)]
    return _said(bool(bad), f"segment {bad} of {points.round(3).tolist()}")


def loops(cubic: Floats) -> bool:
    """Tell whether a plane cubic meets itself, or has a cusp, strictly within its segment.

    P(s) = P(t) means a (s^2 + s t + t^2) + b (s + t) + c = 0; that is linear in s + t and s^2 + s t + t^2.
    """
    _, c, b, a = cubic
    matrix = np.column_stack([a, b])
    if abs(np.linalg.det(matrix)) < 1e-12 * max(1.0, float(np.abs(matrix).max()) ** 2):
        return False  # it is a parabola, or on a line: the other checks are about those
    square, both = np.linalg.solve(matrix, -c)
    product = both**2 - square
    root = both**2 - 4.0 * product
    if root < 0.0:
        return False
    s, t = (both - math.sqrt(root)) / 2.0, (both + math.sqrt(root)) / 2.0
    return bool(s > _HALF_TURN_SHARE and t < 1.0 - _HALF_TURN_SHARE)


@checks.trial("a spline in the plane has no loop and no cusp within a segment")
def _no_loop(rng: np.random.Generator) -> str:
    """Yuksel et al. 2011: centripetal segments have neither cusps nor loops, whatever the points."""
    return _looped(planar_curve, rng)


@checks.trial("re-timed, no sample exceeds a limit")
def _retiming_meets_limits(rng: np.random.Generator) -> str:
    path, limits = random_trajectory(rng), random_limits(rng)
    slower = retimed(path, limits)
    found = sample(slower, np.linspace(slower.start_ns, slower.end_ns, 4000)[1:-1] / NS_PER_S)
    tops = {
        "speed": (found.speeds_m_s.max(), limits.speed_m_s),
        "yaw rate": (np.abs(found.yaw_rates_rad_s).max(), limits.yaw_rate_rad_s),
        "acceleration": (
            _accelerations(slower, found.accelerations_m_s2),
            limits.acceleration_m_s2,
        ),
    }
    over = [
        f"{name} {top:.6g}, allowed {limit:.6g}"
        for name, (top, limit) in tops.items()
        if limit and top > limit * (1 + 1e-6)
    ]
    return "; ".join(over)


def _accelerations(path: Trajectory, inside: Floats) -> float:
    """Return the largest acceleration: of samples, and of a polyline's corners over half of both segments."""
    largest = float(np.linalg.norm(inside, axis=1).max())
    if motion_of(path).exact and len(path.waypoints) > 2:
        times = np.array([w.time_ns for w in path.waypoints]) / NS_PER_S
        places = np.array([w.pose.position_m for w in path.waypoints])
        steps = np.diff(times)
        jumps = np.diff(np.diff(places, axis=0) / steps[:, None], axis=0)
        largest = max(
            largest, float((np.linalg.norm(jumps, axis=1) / ((steps[1:] + steps[:-1]) / 2)).max())
        )
    return largest


@checks.trial("re-timed, poses stay, durations only grow, and once is enough")
def _retiming_keeps_the_path(rng: np.random.Generator) -> str:
    path, limits = random_trajectory(rng), random_limits(rng)
    slower = retimed(path, limits)
    grown = all(b - a <= d - c for (a, b), (c, d) in zip(_spans(path), _spans(slower), strict=True))
    same = [w.pose for w in path.waypoints] == [w.pose for w in slower.waypoints]
    twice = retimed(slower, limits) is slower
    return _said(
        not (grown and same and twice), f"grown {grown}, same poses {same}, done once {twice}"
    )


def _spans(path: Trajectory) -> list[tuple[int, int]]:
    return list(pairwise(w.time_ns for w in path.waypoints))


@checks.trial("a spline within limits, resampled for an action, is a polyline within them")
def _resampling_keeps_limits(rng: np.random.Generator) -> str:
    limits = random_limits(rng)
    spline = retimed(random_trajectory(rng, least=3, kinds=_SPLINE), limits)
    slack = 1.0 + 1e-5
    wider = Limits(
        speed_m_s=limits.speed_m_s and limits.speed_m_s * slack,
        acceleration_m_s2=limits.acceleration_m_s2 and limits.acceleration_m_s2 * slack,
        yaw_rate_rad_s=limits.yaw_rate_rad_s and limits.yaw_rate_rad_s * slack,
    )
    over = limit_violations(resampled(spline, 100_000_000), wider)
    return str(over[0]) if over else ""


@checks.trial("stretched in time, the path stays")
def _stretching_scales_rates(rng: np.random.Generator) -> str:
    path, factor = random_trajectory(rng), float(rng.uniform(1.0, 5.0))
    slower = stretched(path, factor)
    shares = np.linspace(0.05, 0.95, 9)
    times = [(p.start_ns + shares * (p.end_ns - p.start_ns)) / NS_PER_S for p in (path, slower)]
    off = float(
        np.abs(motion_of(path).positions(times[0]) - motion_of(slower).positions(times[1])).max()
    )
    return _said(off > 1e-4, f"off by {off:.1g} m")


@checks.trial("no sample of two agents is closer than the closest approach")
def _clearance_is_the_least(rng: np.random.Generator) -> str:
    """No sample is closer than what is reported, and what is reported is no closer than it states."""
    a, b = random_trajectory(rng), random_trajectory(rng)
    found = closest_approach(a, b)
    start_s, end_s = min(a.start_ns, b.start_ns) / NS_PER_S, max(a.end_ns, b.end_ns) / NS_PER_S
    times = np.linspace(start_s, end_s, 5000)
    apart = np.linalg.norm(motion_of(a).positions(times) - motion_of(b).positions(times), axis=1)
    at = motion_of(a).positions(found.time_s)[0] - motion_of(b).positions(found.time_s)[0]
    real = abs(float(np.linalg.norm(at)) - found.distance_m) < _NEAR_M
    least = found.distance_m - found.tolerance_m <= float(apart.min()) + _NEAR_M
    return _said(
        not (real and least), f"given {found.distance_m:.6f} m, a sample {apart.min():.6f} m"
    )
