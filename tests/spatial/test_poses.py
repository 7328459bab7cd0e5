"""Poses: a group, as SciPy has it, that refuses numbers which are none."""

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from sfglab.messages import default_message, deserialize, message_type, serialize
from sfglab.spatial import Pose, PoseError, StampedTransform

lengths = st.floats(-100, 100)
vectors = st.tuples(lengths, lengths, lengths)
part = st.floats(-1, 1)
quats = st.tuples(part, part, part, part).filter(lambda q: math.hypot(*q) > 1e-3)
poses = st.builds(Pose.at, vectors, quats)


@given(poses, poses, poses)
def test_composition_is_associative(a, b, c):
    assert ((a @ b) @ c).same_as(a @ (b @ c), within_m=1e-9, within_rad=1e-7)


@given(poses)
def test_the_identity_changes_nothing_and_the_inverse_undoes(pose):
    assert (pose @ Pose()).same_as(pose)
    assert (Pose() @ pose).same_as(pose)
    assert (pose @ pose.inverse()).same_as(Pose(), within_rad=1e-7)
    assert (pose.inverse() @ pose).same_as(Pose(), within_rad=1e-7)
    assert pose.inverse().inverse().same_as(pose, within_rad=1e-7)


@given(poses, poses, vectors)
def test_products_and_points_are_those_of_the_matrices(a, b, point):
    assert np.allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)
    assert np.allclose(a.apply(point), (a.matrix() @ [*point, 1.0])[:3], atol=1e-9)
    assert np.allclose(
        (a @ b).rotation.as_matrix(), (a.rotation * b.rotation).as_matrix(), atol=1e-12
    )


@given(poses, poses, st.floats(0, 1))
def test_interpolation_is_linear_in_position_and_scipys_slerp_in_orientation(a, b, fraction):
    between = a.interpolate(b, fraction)
    way_m = np.subtract(b.position_m, a.position_m)
    assert np.allclose(between.position_m, np.add(a.position_m, fraction * way_m))
    if a.angle_rad(b) < math.pi - 1e-3:  # half a turn has no short way
        slerp = Slerp([0, 1], Rotation.concatenate([a.rotation, b.rotation]))
        assert (between.rotation.inv() * slerp(fraction)).magnitude() < 1e-7


@given(poses)
def test_poses_survive_rotations_and_messages(pose):
    assert Pose.from_rotation(pose.position_m, pose.rotation).same_as(pose, within_rad=1e-7)
    for message in (pose.to_pose_msg(), pose.to_transform_msg()):
        assert Pose.from_msg(deserialize(serialize(message), type(message))) == pose


@given(poses)
def test_what_was_normalised_stays_bit_by_bit(pose):
    assert Pose(position_m=pose.position_m, quat_xyzw=pose.quat_xyzw) == pose
    assert Pose.at(list(pose.position_m), np.array(pose.quat_xyzw)) == pose


def test_a_quarter_turn_and_a_step_have_known_numbers_and_both_signs_are_one_orientation():
    quarter = Pose.from_yaw((1.0, 2.0, 3.0), math.pi / 2)
    assert quarter.quat_xyzw == pytest.approx((0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    assert quarter.yaw_rad == pytest.approx(math.pi / 2)
    assert Pose().interpolate(quarter, 2.0).yaw_rad == pytest.approx(math.pi)
    assert Pose().angle_rad(quarter) == pytest.approx(math.pi / 2)
    a = Pose.from_yaw((0, 0, 0), 0.2)
    b = Pose.at((0, 0, 0), [-c for c in Pose.from_yaw((0, 0, 0), 0.4).quat_xyzw])
    assert a.angle_rad(b) == pytest.approx(0.2)
    assert a.interpolate(b, 0.5).yaw_rad == pytest.approx(0.3)


here = partial(Pose.at, place="here")
NO_TURN = default_message("geometry_msgs/msg/Pose")
NO_TURN.orientation.w = 0.0


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            partial(here, (0, 0, math.nan)),
            r"^here, position: given \[0.0, 0.0, nan\], allowed: 3 finite",
        ),
        (partial(here, (0, 0, math.inf)), "^here, position: .* finite"),
        (partial(here, (0, 0)), "^here, position: .* 3 finite numbers"),
        (partial(here, "abc"), "^here, position: .* 3 numbers"),
        (partial(here, 3.0), "^here, position: .* 3 numbers"),
        (
            partial(here, (0, 0, 0), (0, 0, 0, 0)),
            "^here, quaternion: .* a length of at least 1e-06",
        ),
        (partial(here, (0, 0, 0), (0, 0, 0, math.nan)), "^here, quaternion: .* 4 finite numbers"),
        (partial(here, (0, 0, 0), (0, 0, 1)), "^here, quaternion: .* 4 finite numbers"),
        (
            partial(here, (0, 0, 0), (1e308, 1e308, 1e308, 1e308)),
            "^here, quaternion: .* finite length",
        ),
        (partial(Pose, quat_xyzw=(0.0, 0.0, 0.0, 0.0)), "^pose, quaternion"),
        (
            partial(Pose.from_msg, NO_TURN, place="odom"),
            "^odom, quaternion",
        ),
    ],
)
def test_what_is_no_pose_is_refused_with_its_place(make, says):
    with pytest.raises(PoseError, match=says):
        make()


def test_a_stamped_transform_is_the_message_and_loses_its_leading_slashes():
    value = StampedTransform(
        parent="map",
        child="go2/base",
        stamp_ns=1_700_000_000_123_456_789,
        pose=Pose.from_yaw((1, 2, 3), 1.0),
    )
    message = value.to_msg()
    assert type(message) is message_type("geometry_msgs/msg/TransformStamped")
    assert StampedTransform.from_msg(deserialize(serialize(message), type(message))) == value
    message.header.frame_id, message.child_frame_id = "/map", "/go2/base"
    assert StampedTransform.from_msg(message) == value
    message.transform.rotation.w = message.transform.rotation.z = 0.0
    with pytest.raises(PoseError, match="tf map -> go2/base, quaternion"):
        StampedTransform.from_msg(message, place="tf")
