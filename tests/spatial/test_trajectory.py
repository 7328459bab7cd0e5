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

from sfglab.messages import deserialize, serialize
from sfglab.spatial import Pose
from sfglab.spatial.execution.orders import Order, RefusalError, goal_message, order_from_goal
from sfglab.spatial.trajectory.motion import motion_of, resampled, sample
from sfglab.spatial.trajectory.path import (
    LATEST_NS,
    Align,
    Interpolation,
    Trajectory,
    TrajectoryError,
    aligned_quat,
    in_frame,
)

S = 1_000_000_000
SPLINE = Interpolation.CATMULL_ROM


def line(*points, step_ns=S, interpolation=Interpolation.POLYLINE):
    return Trajectory.of(
        [(i * step_ns, Pose.at((*p, 0.0))) for i, p in enumerate(points)], interpolation
    )


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


def test_a_wait_in_a_spline_is_at_rest_and_turning_on_the_spot_turns_at_an_even_rate():
    trajectory = line((0, 0), (2, 1), (2, 1), (5, 0), interpolation=SPLINE)
    found = sample(trajectory, [1.0, 1.3, 1.9, 2.0])
    assert found.positions_m == pytest.approx(np.tile([2.0, 1.0, 0.0], (4, 1)))
    assert found.speeds_m_s == pytest.approx(np.zeros(4), abs=1e-12)
    for kind in Interpolation:
        poses_ = [Pose(), Pose.from_yaw((0, 0, 0), 1.0), Pose.from_yaw((0, 0, 0), 3.0)]
        trajectory = Trajectory.of([(i * 2 * S, p) for i, p in enumerate(poses_)], kind)
        angular = sample(trajectory, [0.5, 1.0, 3.0]).angular_rad_s
        assert angular[:, 2] == pytest.approx([0.5, 0.5, 1.0])


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


def test_before_the_start_after_the_end_and_with_one_waypoint_an_agent_stands():
    path = Trajectory.of([(S, Pose()), (2 * S, Pose.from_yaw((3.0, 0.0, 0.0), 1.0))])
    for trajectory, wanted in ((path, [0.0, 0.0, 3.0]), (Trajectory.standing(Pose()), [0.0] * 3)):
        found = sample(trajectory, [0.0, 0.999, 5.0])
        assert found.positions_m[:, 0] == pytest.approx(wanted)
        assert not found.velocities_m_s.any()
        assert not found.angular_rad_s.any()


def test_resampling_a_spline_gives_a_polyline_close_to_it_that_keeps_its_waypoints():
    trajectory = line((0, 0), (2, 0), (2, 2), (4, 2), interpolation=SPLINE)
    found = resampled(trajectory, S // 50)
    times_ns = {waypoint.time_ns for waypoint in trajectory.waypoints}
    assert times_ns <= {waypoint.time_ns for waypoint in found.waypoints}
    assert found.interpolation is Interpolation.POLYLINE
    times = np.linspace(trajectory.start_ns / S, trajectory.end_ns / S, 999)
    gap = np.linalg.norm(
        motion_of(found).positions(times) - motion_of(trajectory).positions(times), axis=1
    )
    assert gap.max() < 1e-3
    assert np.diff([w.time_ns for w in found.waypoints]).max() == S // 50


def at_times(*times_ns):
    return Trajectory.of([(time_ns, Pose()) for time_ns in times_ns])


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (at_times, "no waypoint"),
        (
            lambda: at_times(5, 5),
            "waypoint 1, time: given 5 ns, allowed: whole nanoseconds above 5",
        ),
        (lambda: at_times(5, 4), "above 5"),
        (lambda: at_times(-1), "above -1"),
        (lambda: at_times(LATEST_NS + 1), "waypoint 0"),
    ],
)
def test_what_no_trajectory_can_be_is_refused(make, says):
    with pytest.raises(TrajectoryError, match=says):
        make()


def test_straight_up_and_without_alignment_a_waypoint_keeps_its_own_orientation():
    assert aligned_quat([(0, 0, 0), (0, 0, 3)], 0, Align.NEXT) is None
    assert aligned_quat([(0, 0, 0), (1, 1, 0)], 0, Align.NONE) is None


def test_a_goal_has_velocities_of_the_segments_that_leave():
    points = [
        (0, Pose()),
        (S, Pose.at((2.0, 0.0, 0.0))),
        (3 * S, Pose.from_yaw((2.0, 2.0, 0.0), 1.0)),
    ]
    goal = goal_message(Order(agent="go2", trajectory=Trajectory.of(points)))
    velocities = [point.velocities[0] for point in goal.trajectory.points]
    assert [one.linear.x for one in velocities] == pytest.approx([2.0, 0.0, 0.0])
    assert [one.angular.z for one in velocities] == pytest.approx([0.0, 0.5, 0.5])


def _without_transforms(goal):
    goal.trajectory.points[0].transforms = []


def _without_joints(goal):
    goal.trajectory.joint_names = []
    _without_transforms(goal)
    goal.trajectory.points[1].transforms = []


def _backwards(goal):
    goal.trajectory.points.reverse()


def _without_orientation(goal):
    goal.trajectory.points[0].transforms[0].rotation.w = 0.0


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (_without_transforms, "point 0: given 0 transforms"),
        (_backwards, "waypoint 1, time"),
        (_without_orientation, "point 0"),
        (lambda goal: goal.trajectory.points.clear(), "no waypoint"),
        (_without_joints, r"joint_names: given \[\], allowed: 'go2'"),
    ],
)
def test_goals_without_a_trajectory_are_refused_with_the_place(spoil, says):
    goal = goal_message(Order(agent="go2", trajectory=at_times(0, S)))
    spoil(goal)
    with pytest.raises(RefusalError, match=says):
        order_from_goal(goal)
