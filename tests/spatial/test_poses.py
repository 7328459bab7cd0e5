"""Poses: products and interpolation as SciPy computes them, messages, and refused numbers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from sfglab.messages import deserialize, serialize
from sfglab.spatial import Pose, PoseError, StampedTransform

lengths = st.floats(-100, 100)
vectors = st.tuples(lengths, lengths, lengths)
part = st.floats(-1, 1)
quats = st.tuples(part, part, part, part).filter(lambda q: math.hypot(*q) > 1e-3)
poses = st.builds(Pose.at, vectors, quats)


def turn(pose):
    return Rotation.from_quat(pose.quat_xyzw)


@given(poses, poses, vectors)
def test_products_inverses_and_points_are_those_of_the_matrices(a, b, point):
    assert np.allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)
    assert np.allclose(a.inverse().matrix() @ a.matrix(), np.eye(4), atol=1e-9)
    assert np.allclose(a.apply(point), (a.matrix() @ [*point, 1.0])[:3], atol=1e-9)
    assert a.same_as(Pose.from_rotation(a.position_m, turn(a)), within_rad=1e-7)
    assert a.angle_rad(b) == pytest.approx((turn(a).inv() * turn(b)).magnitude(), abs=1e-7)


@given(poses, poses, st.floats(0, 1))
def test_interpolation_is_linear_in_position_and_scipys_slerp_in_orientation(a, b, fraction):
    between = a.interpolate(b, fraction)
    way_m = np.subtract(b.position_m, a.position_m)
    assert np.allclose(between.position_m, np.add(a.position_m, fraction * way_m))
    if a.angle_rad(b) < math.pi - 1e-3:  # half a turn has no short way
        slerp = Slerp([0, 1], Rotation.concatenate([turn(a), turn(b)]))
        assert (turn(between).inv() * slerp(fraction)).magnitude() < 1e-7


@given(poses)
def test_a_pose_is_read_back_bit_by_bit_from_messages_and_numbers(pose):
    for message in (pose.to_pose_msg(), pose.to_transform_msg()):
        assert Pose.from_msg(deserialize(serialize(message), type(message))) == pose
    assert Pose(position_m=pose.position_m, quat_xyzw=pose.quat_xyzw) == pose


def test_a_quarter_turn_has_known_numbers_and_both_signs_are_one_orientation():
    quarter = Pose.from_yaw((0, 0, 0), math.pi / 2)
    half = math.sqrt(0.5)
    assert quarter.quat_xyzw == pytest.approx((0, 0, half, half))
    assert Pose.at(quat_xyzw=(0, 0, -half, -half)).same_as(quarter)
    assert Pose().interpolate(quarter, 1.5).yaw_rad == pytest.approx(0.75 * math.pi)


NONE = (0, 0, 0, 1)


@pytest.mark.parametrize(
    ("position", "quat", "says"),
    [
        ((0, 0, math.nan), NONE, r"^here, position: given \[0.0, 0.0, nan\], .*: 3 finite"),
        ((0, 0), NONE, "^here: .* 3 numbers as position"),
        ("abc", NONE, "^here: .* 3 numbers as position"),
        (3.0, NONE, "^here: .* 3 numbers as position"),
        ((0, 0, 0), [0] * 4, "^here, quaternion: .* length of at least 1e-06"),
        ((0, 0, 0), [1e308] * 4, "^here, quaternion: .* finite length"),
    ],
)
def test_numbers_that_are_no_pose_are_refused_with_their_place(position, quat, says):
    with pytest.raises(PoseError, match=says):
        Pose.at(position, quat, place="here")


def test_a_stamped_transform_is_the_message_without_leading_slashes():
    pose = Pose.from_yaw((1, 2, 3), 1.0)
    value = StampedTransform(parent="map", child="go2/base", stamp_ns=1_700_000_000_123, pose=pose)
    message = deserialize(serialize(value.to_msg()), "geometry_msgs/msg/TransformStamped")
    message.header.frame_id = "/map"
    assert StampedTransform.from_msg(message) == value
    message.transform.rotation.z = message.transform.rotation.w = 0.0
    with pytest.raises(PoseError, match="transform map -> go2/base, quaternion"):
        StampedTransform.from_msg(message)
