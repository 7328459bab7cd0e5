"""Trajectories: what holds for any of them, known numbers, messages, and what is refused.

The experiment `planning` tries alignment, polylines and the formula of splines.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trajectory_strategies import poses, trajectories

from sfglab.errors import InvalidValueError
from sfglab.messages import deserialize, serialize
from sfglab.spatial import Pose
from sfglab.spatial.execution.orders import Order, RefusalError, goal_message, order_from_goal
from sfglab.spatial.trajectory.motion import motion_of, pose_at, resampled, sample
from sfglab.spatial.trajectory.path import (
    LATEST_NS,
    Align,
    Interpolation,
    Trajectory,
    aligned_quat,
    in_frame,
)

S = 1_000_000_000
SPLINE = Interpolation.CATMULL_ROM


def line(*points):
    """A spline with a waypoint each second."""
    return Trajectory.of(((i * S, Pose.at((*p, 0.0))) for i, p in enumerate(points)), SPLINE)


@settings(deadline=None)
@given(trajectories(), poses)
def test_waypoints_are_met_poses_are_rigid_and_frames_commute_with_interpolation(trajectory, frame):
    points = trajectory.waypoints
    for point in points:
        assert pose_at(trajectory, point.time_ns / S).same_as(point.pose, within_rad=1e-6)
    between = np.linspace(points[0].time_ns / S - 1.0, points[-1].time_ns / S + 1.0, 15)
    here, there = sample(trajectory, between), sample(in_frame(trajectory, frame), between)
    assert np.linalg.norm(here.quats_xyzw, axis=1) == pytest.approx(np.ones(15))
    # A turn by half a circle is equally short either way.
    turn_rad = max(a.pose.angle_rad(b.pose) for a, b in pairwise(points))
    within_rad = 1e-5 if turn_rad < 3.1 else math.pi
    for index in range(15):
        moved = frame @ here.pose(index)
        assert moved.same_as(there.pose(index), within_m=1e-6, within_rad=within_rad)


@settings(deadline=None)
@given(trajectories(least=3, interpolation=st.just(SPLINE)))
def test_the_velocity_of_a_spline_does_not_jump_at_waypoints(trajectory):
    inner = np.array([w.time_ns for w in trajectory.waypoints[1:-1]]) / S
    before, after = sample(trajectory, np.nextafter(inner, 0.0)), sample(trajectory, inner)
    fastest = max(1.0, after.speeds_m_s.max(), before.speeds_m_s.max())
    assert after.velocities_m_s == pytest.approx(before.velocities_m_s, abs=1e-6 * fastest)


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(-2, 1), st.integers(1, 3 * S)), min_size=3, max_size=7),
    st.sampled_from([(1.0, 0.0, 0.0), (0.6, -0.8, 0.0), (0.48, 0.6, 0.64)]),
)
def test_a_spline_along_a_line_never_goes_back(steps, way):
    along = np.cumsum([10.0**exponent for exponent, _ in steps])
    times = np.cumsum([step_ns for _, step_ns in steps])
    places = zip(times.tolist(), np.outer(along, way), strict=True)
    path = Trajectory.of(((t, Pose.at(p)) for t, p in places), SPLINE)
    found = sample(path, np.linspace(path.start_ns, path.end_ns, 500) / S)
    assert (found.velocities_m_s @ way).min() >= -1e-9 * found.speeds_m_s.max()


@settings(deadline=None, max_examples=30)
@given(trajectories(interpolation=st.just(Interpolation.POLYLINE)), st.integers(1, 10**18))
def test_messages_give_back_every_nanosecond_and_bit(trajectory, start_ns):
    order = Order(agent="go2", trajectory=trajectory, frame_id="hall", start_ns=start_ns)
    goal = goal_message(order)
    assert order_from_goal(deserialize(serialize(goal), type(goal))) == order


@settings(deadline=None)
@given(trajectories(most=5))
def test_rates_are_the_derivatives_of_what_is_sampled(trajectory):
    times_s = motion_of(trajectory).times_s
    for start, duration in zip(times_s[:-1], np.diff(times_s), strict=True):
        times, h = start + duration * np.array([0.21, 0.5, 0.83]), 1e-6 * duration
        low, here, high = (sample(trajectory, times + d) for d in (-h, 0.0, h))
        slope = (high.positions_m - low.positions_m) / (2 * h)
        scale = 1e-4 * max(1.0, here.speeds_m_s.max())
        assert slope == pytest.approx(here.velocities_m_s, rel=1e-4, abs=scale)


def test_an_agent_stands_before_the_start_after_the_end_and_while_it_waits():
    path = line((0, 0), (2, 1), (2, 1), (5, 0))
    found = sample(path, [-1.0, 1.0, 1.3, 2.0, 9.0])
    assert found.positions_m[:, 0] == pytest.approx([0.0, 2.0, 2.0, 2.0, 5.0])
    assert found.velocities_m_s == pytest.approx(np.zeros((5, 3)), abs=1e-12)
    assert sample(Trajectory.standing(Pose()), [0.0, 5.0]).speeds_m_s.tolist() == [0.0, 0.0]


def test_resampling_a_spline_gives_a_polyline_close_to_it_that_keeps_its_waypoints():
    trajectory = line((0, 0), (2, 0), (2, 2), (4, 2))
    found = resampled(trajectory, 15 * S // 1000)
    assert found.interpolation is Interpolation.POLYLINE
    times_ns = [w.time_ns for w in found.waypoints]
    assert {0, S, 2 * S, 3 * S} <= set(times_ns)
    assert np.diff(times_ns).max() == 15 * S // 1000
    times = np.linspace(0.0, 3.0, 999)
    polyline, spline = (motion_of(path).positions(times) for path in (found, trajectory))
    assert polyline == pytest.approx(spline, abs=1e-3)


@pytest.mark.parametrize(
    ("times_ns", "says"),
    [
        ((), "at least one waypoint"),
        ((5, 5), "waypoint 1, time: given 5, allowed: whole nanoseconds above 5"),
        ((-1,), "above -1"),
        ((LATEST_NS + 1,), "waypoint 0"),
    ],
)
def test_what_no_trajectory_can_be_is_refused(times_ns, says):
    with pytest.raises(InvalidValueError, match=says):
        Trajectory.of([(time_ns, Pose()) for time_ns in times_ns])


def test_straight_up_and_without_alignment_a_waypoint_keeps_its_own_orientation():
    assert aligned_quat([(0, 0, 0), (0, 0, 3)], 0, Align.NEXT) is None
    assert aligned_quat([(0, 0, 0), (1, 1, 0)], 0, Align.NONE) is None


def goal_of(*points):
    return goal_message(Order(agent="go2", trajectory=Trajectory.of(points)))


def test_a_goal_has_velocities_of_the_segments_that_leave():
    turned = Pose.from_yaw((2.0, 2.0, 0.0), 1.0)
    goal = goal_of((0, Pose()), (S, Pose.at((2.0, 0.0, 0.0))), (3 * S, turned))
    found = [(v.linear.x, v.angular.z) for p in goal.trajectory.points for v in p.velocities]
    assert np.array(found) == pytest.approx(np.array([(2.0, 0.0), (0.0, 0.5), (0.0, 0.5)]))


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda path: path.points[0].transforms.clear(), "point 0, number of transforms: given 0"),
        (lambda path: path.points.reverse(), "waypoint 1, time"),
        (lambda path: setattr(path.points[0].transforms[0].rotation, "w", 0.0), "point 0"),
        (lambda path: path.points.clear(), "at least one waypoint"),
        (lambda path: path.joint_names.clear(), r"joint_names: given \[\], allowed: 'go2'"),
    ],
)
def test_goals_without_a_trajectory_are_refused_with_the_place(spoil, says):
    goal = goal_of((0, Pose()), (S, Pose()))
    spoil(goal.trajectory)
    with pytest.raises(RefusalError, match=says):
        order_from_goal(goal)
