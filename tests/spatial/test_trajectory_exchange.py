"""Trajectories out and in again: Path, MultiDOFJointTrajectory and CSV give back what they were given."""

from __future__ import annotations

import pytest

from sfglab.messages import deserialize, serialize
from sfglab.spatial import Pose, PoseError
from sfglab.spatial.trajectory import (
    Interpolation,
    Trajectory,
    TrajectoryError,
    csv_from_trajectory,
    multi_dof_from_trajectory,
    path_from_trajectory,
    sample,
    trajectory_from_csv,
    trajectory_from_multi_dof,
    trajectory_from_path,
)

S = 1_000_000_000
START_NS = 1_700_000_000_123_456_789
PATH = "nav_msgs/msg/Path"
MULTI_DOF = "trajectory_msgs/msg/MultiDOFJointTrajectory"


def wired(message, type_name):
    return deserialize(serialize(message), type_name)


def test_a_multi_dof_trajectory_says_how_fast_and_for_splines_how_bent():
    points = [(0, Pose()), (S, Pose.at((2.0, 0.0, 0.0))), (3 * S, Pose.from_yaw((2.0, 2.0, 0.0), 1.0))]
    line, spline = (Trajectory.of(points, kind) for kind in Interpolation)
    first = multi_dof_from_trajectory(line, "go2", frame_id="map").points
    assert [p.velocities[0].linear.x for p in first] == pytest.approx([2.0, 0.0, 0.0])
    assert [p.velocities[0].angular.z for p in first] == pytest.approx([0.0, 0.5, 0.5])
    assert not any(p.accelerations for p in first)
    second = multi_dof_from_trajectory(spline, "go2", frame_id="map").points
    found = sample(spline, [0.0, 1.0, 3.0]).accelerations_m_s2
    assert [p.accelerations[0].linear.y for p in second] == pytest.approx(found[:, 1])
    assert found[1, 1] != 0.0


def test_csv_is_plain_to_read():
    text = csv_from_trajectory(Trajectory.of([(1_500_000_001, Pose.at((1.0, -2.5, 0.0)))]))
    assert text == "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n1.500000001,1.0,-2.5,0.0,0.0,0.0,0.0,1.0\n"


HEAD = "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", r"path\.csv:1: given nothing"),
        ("t,x,y\n0,0,0\n", r"path\.csv:1: given t,x,y, allowed: time_s"),
        (HEAD, r"path\.csv: given no waypoint"),
        (HEAD + "0,0,0,0,0,0,0,1\n1,0,0,0,0,0,1\n", r"path\.csv:3: given 7 fields"),
        (HEAD + "0,0,here,0,0,0,0,1\n", r"path\.csv:2: .* eight numbers"),
        (HEAD + "soon,0,0,0,0,0,0,1\n", r"path\.csv:2: .* eight numbers"),
        (HEAD + "Infinity,0,0,0,0,0,0,1\n", r"path\.csv:2"),
        (HEAD + "nan,0,0,0,0,0,0,1\n", r"path\.csv:2"),
        (HEAD + "2,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n", r"path\.csv:3: given 1 s, allowed: a time above 2\.0 s"),
        (HEAD + "0,0,nan,0,0,0,0,1\n", r"path\.csv:2.* finite"),
        (HEAD + "0,0,0,0,0,0,0,0\n", r"path\.csv:2.*quaternion"),
    ],
)
def test_broken_csv_is_refused_with_its_line(text, says):
    with pytest.raises(TrajectoryError, match=says):
        trajectory_from_csv(text, file="path.csv")


def test_a_joint_that_is_not_there_is_named():
    message = multi_dof_from_trajectory(Trajectory.standing(Pose()), "go2", frame_id="map")
    with pytest.raises(TrajectoryError, match="given 'spot', allowed: one of go2"):
        trajectory_from_multi_dof(message, "spot")


def test_a_point_without_a_transform_for_each_joint_is_refused():
    message = multi_dof_from_trajectory(Trajectory.standing(Pose()), "go2", frame_id="map")
    message.points[0].transforms = []
    with pytest.raises(TrajectoryError, match="point 0: given 0 transforms"):
        trajectory_from_multi_dof(message)


def test_a_path_whose_pose_nobody_filled_is_refused_by_place():
    message = path_from_trajectory(Trajectory.standing(Pose()), frame_id="map")
    message.poses[0].pose.orientation.w = 0.0
    with pytest.raises(PoseError, match="path, pose 0"):
        trajectory_from_path(message)


def test_a_path_whose_stamps_run_backwards_is_refused():
    message = path_from_trajectory(Trajectory.of([(0, Pose()), (S, Pose())]), frame_id="map")
    message.poses.reverse()
    with pytest.raises(TrajectoryError, match="waypoint 1, time"):
        trajectory_from_path(message)
