"""Messages as ROS 2's tools print and read them."""

import numpy as np
import pytest
from random_messages import random_message

from sfglab.errors import InvalidValueError
from sfglab.messages import default_message, deserialize, message_types, serialize
from sfglab.messages.text import message_from_yaml, to_yaml, value_at, values_of

NAMES = (
    message_types()
)  # as they come: other tests register some whose bounds random values do not keep
JOINTS = "sensor_msgs/msg/JointState"


def test_what_is_printed_of_any_type_is_read_back():
    rng = np.random.default_rng(5)
    for name in NAMES:
        given = deserialize(serialize(random_message(rng, name)), name)
        text = to_yaml(values_of(given))
        read = message_from_yaml(name, text, "VALUES")
        for field in vars(given):
            if field == "structure_needs_at_least_one_member":
                setattr(read, field, getattr(given, field))
        # A number that is none is read back as one, not to the bit.
        assert to_yaml(values_of(read)) == text, name


def test_fields_that_are_not_given_have_the_defaults_of_the_definition():
    pose = message_from_yaml("geometry_msgs/msg/Pose", "{position: {x: 1.0}}", "VALUES")
    assert (pose.position.x, pose.orientation.w) == (1.0, 1.0)


def test_long_values_are_cut_as_ros2_does():
    message = default_message(JOINTS, name=["shoulder", "elbow"], position=np.arange(3.0))
    message.header.frame_id = "abcde"
    cut = values_of(message, 2)
    assert (cut["header"]["frame_id"], cut["name"]) == ("ab...", ["sh...", "el..."])
    assert cut["position"] == [0.0, 1.0, "..."]
    assert value_at(values_of(message), "position[2]", "--field") == 2.0


WRONG = {
    (JOINTS, "["): "YAML",
    (JOINTS, "3"): "fields in braces",
    (JOINTS, "{nam: [a]}"): "header, name, position, velocity, effort",
    (JOINTS, "{name: a}"): "a list of values",
    (JOINTS, "{name: [{}]}"): "text",
    (JOINTS, "{position: [x]}"): "a number",
    (JOINTS, "{position: [true]}"): "a number",
    (
        JOINTS,
        "{header: {stamp: {sec: 2147483648}}}",
    ): "a whole number from -2147483648 to 2147483647",
    (JOINTS, "{header: {stamp: {sec: 1.5}}}"): "a whole number",
    (JOINTS, "{header: {stamp: then}}"): "fields in braces",
    ("sensor_msgs/msg/Imu", "{orientation_covariance: [1]}"): "a list of 9 values",
    ("shape_msgs/msg/SolidPrimitive", "{dimensions: [1, 2, 3, 4]}"): "a list of up to 3 values",
    ("std_msgs/msg/Bool", "{data: 1}"): "true or false",
}


@pytest.mark.parametrize(("name", "text"), WRONG)
def test_what_is_no_message_is_refused_with_its_place_and_what_is_allowed(name, text):
    with pytest.raises(InvalidValueError) as refused:
        message_from_yaml(name, text, "VALUES")
    assert str(refused.value).startswith("VALUES")
    assert WRONG[name, text] in refused.value.allowed


def test_now_and_auto_stand_for_the_time():
    message = message_from_yaml("geometry_msgs/msg/PoseStamped", "{header: auto}", "VALUES")
    stamp = message_from_yaml("std_msgs/msg/Header", "{stamp: now}", "VALUES").stamp
    assert 0 <= stamp.sec - message.header.stamp.sec <= 60
    assert message.header.stamp.sec > 1.7e9
