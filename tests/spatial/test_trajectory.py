"""Trajectories: what holds for any of them, known numbers, messages, and what is refused.

The experiment `planning` tries alignment, polylines and the formula of splines.
"""

from dataclasses import replace
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
from sfglab.spatial.trajectory.motion import motion_of, resampled, sample
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
    times = [w.time_ns / S for w in trajectory.waypoints]
    found = sample(trajectory, times)
    for index, waypoint in enumerate(trajectory.waypoints):
        assert found.pose(index).same_as(waypoint.pose, within_rad=1e-6)
    between = np.linspace(times[0] - 1.0, times[-1] + 1.0, 15)
    here, there = sample(trajectory, between), sample(in_frame(trajectory, frame), between)
    assert np.linalg.norm(here.quats_xyzw, axis=1) == pytest.approx(np.ones(15))
    # A turn by half a circle is equally short either way.
    turns = [a.pose.angle_rad(b.pose) for a, b in pairwise(trajectory.waypoints)]
    for index in range(15):
        moved = frame @ here.pose(index)
        assert moved.distance_m(there.pose(index)) < 1e-6
        if max(turns) < 3.1:
            assert moved.angle_rad(there.pose(index)) < 1e-5


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
@given(trajectories(), st.integers(1, 10**18))
def test_messages_give_back_every_nanosecond_and_bit(trajectory, start_ns):
    def received(message):
        return deserialize(serialize(message), type(message))

    line = replace(trajectory, interpolation=Interpolation.POLYLINE)
    order = Order(agent="go2", trajectory=line, frame_id="hall", start_ns=start_ns)
    assert order_from_goal(received(goal_message(order))) == order


@settings(deadline=None)
@given(trajectories(most=5))
def test_rates_are_the_derivatives_of_what_is_sampled(trajectory):
    motion, h = motion_of(trajectory), 1e-6
    for start, duration in zip(motion.times_s[:-1], np.diff(motion.times_s), strict=True):
        times = start + duration * np.array([0.21, 0.5, 0.83])
        low, here, high = (
            sample(trajectory, times + d) for d in (-h * duration, 0.0, h * duration)
        )
        slope = (high.positions_m - low.positions_m) / (2 * h * duration)
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
    gaps = motion_of(found).positions(times) - motion_of(trajectory).positions(times)
    assert np.abs(gaps).max() < 1e-3


def at_times(*times_ns):
    return Trajectory.of([(time_ns, Pose()) for time_ns in times_ns])


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
        at_times(*times_ns)


def test_straight_up_and_without_alignment_a_waypoint_keeps_its_own_orientation():
    assert aligned_quat([(0, 0, 0), (0, 0, 3)], 0, Align.NEXT) is None
    assert aligned_quat([(0, 0, 0), (1, 1, 0)], 0, Align.NONE) is None


def goal_of(*points):
    return goal_message(Order(agent="go2", trajectory=Trajectory.of(points)))


def test_a_goal_has_velocities_of_the_segments_that_leave():
    goal = goal_of(
        (0, Pose()), (S, Pose.at((2.0, 0.0, 0.0))), (3 * S, Pose.from_yaw((2.0, 2.0, 0.0), 1.0))
    )
    velocities = [point.velocities[0] for point in goal.trajectory.points]
    assert [one.linear.x for one in velocities] == pytest.approx([2.0, 0.0, 0.0])
    assert [one.angular.z for one in velocities] == pytest.approx([0.0, 0.5, 0.5])


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
