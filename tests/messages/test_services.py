import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from sfglab import messages
from sfglab.messages.store import interface_texts, parse_definition, register_texts


def test_the_header_stands_before_the_fields_and_a_big_endian_frame_is_read():
    cdr = messages.serialize(messages.default_message("sfglab_interfaces/srv/GetMetadata_Request"))
    framed = messages.frame_service(messages.ServiceFrame(0x1122334455667788, 9, cdr))
    assert framed == bytes.fromhex("00010000 8877665544332211 0900000000000000 00000000")
    assert messages.unframe_service(bytes(4) + struct.pack(">Qq", 1, -2) + b"x") == (
        1,
        -2,
        bytes(4) + b"x",
    )


@given(st.integers(0, 2**64 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(max_size=40))
def test_a_frame_comes_back(guid, sequence, body):
    frame = messages.ServiceFrame(guid, sequence, b"\0\1\0\0" + body)
    assert messages.unframe_service(messages.frame_service(frame)) == frame


@pytest.mark.parametrize("data", [b"", bytes(19), b"\0\6\0\0" + bytes(16), b"\1\1\0\0" + bytes(16)])
def test_what_has_no_header_is_refused(data):
    with pytest.raises(messages.MessageError, match="rmw_cyclonedds"):
        messages.unframe_service(data)


FOLLOW = "sfglab_interfaces/action/FollowTrajectory"
COUNT = "sfglab_test_interfaces/action/Count"
NOTHING = "sfglab_test_interfaces/action/Nothing"
TEXT = "int32 until\nint32 LIMIT=9\n---\nint32 reached\n---\nint32 now\n"


def fields(type_):
    return {
        name for name in type_.__dataclass_fields__ if name != "__msgtype__" and not name.isupper()
    }


def test_an_action_is_three_parts_and_the_wrappers_of_the_ros_2_design():
    action = messages.action_type(FOLLOW)
    parts = [action.goal, action.result, action.feedback, action.feedback_message]
    parts += [
        half for s in (action.send_goal, action.get_result) for half in (s.request, s.response)
    ]
    assert [" ".join(sorted(fields(part))) for part in parts] == [
        "agent trajectory",
        "error_code final_pose text",
        "distance_error pose progress time_from_start",
        "feedback goal_id",
        "goal goal_id",
        "accepted stamp",
        "goal_id",
        "result status",
    ]


def test_a_request_for_a_goal_is_the_id_and_then_the_goal_and_no_field_is_one_octet():
    register_texts(interface_texts(COUNT, TEXT))
    action = messages.action_type(COUNT)
    uuid = messages.message_type("unique_identifier_msgs/msg/UUID")(
        uuid=np.arange(16, dtype=np.uint8)
    )
    cdr = messages.serialize(action.send_goal.request(goal_id=uuid, goal=action.goal(until=7)))
    assert cdr == b"\0\1\0\0" + bytes(range(16)) + b"\7\0\0\0"
    assert messages.deserialize(cdr, action.send_goal.request).goal.until == 7
    assert action.goal.LIMIT == 9
    register_texts(interface_texts(NOTHING, "---\n---\n"))
    action = messages.action_type(NOTHING)
    for type_ in (action.goal, action.result, action.feedback):
        assert len(messages.serialize(messages.default_message(type_))) == len(b"\0\1\0\0\0\0\0\0")


def test_a_definition_holds_the_part_that_is_wrapped():
    action = messages.action_type(FOLLOW)
    for type_ in (action.send_goal.request, action.get_result.response, action.feedback_message):
        text = messages.definition(type_)
        read = get_types_from_msg(text, messages.type_name(type_))
        assert f"MSG: {FOLLOW}_" in text
        assert len(read) == text.count("MSG: ") + 1
        assert any(name.endswith("unique_identifier_msgs/msg/UUID") for name in read) == (
            "goal_id" in text
        )


@pytest.mark.parametrize("text", ["", "int32 a\n---\nint32 b\n", "---\n---\n---\n"])
def test_a_text_without_three_parts_is_refused_with_their_number(text):
    count = text.count("---") + 1
    with pytest.raises(messages.MessageError, match=rf"a/action/B: given {count} part"):
        interface_texts("a/action/B", text)


def test_a_short_name_is_looked_for_in_its_package_and_an_unknown_action_told_its_neighbours():
    name = "sfglab_interfaces/action/Watch_Goal"
    (_, fields_of_goal), *_ = parse_definition(name, "StreamInfo stream").values()
    assert [desc[1] for _, desc in fields_of_goal] == ["sfglab_interfaces/msg/StreamInfo"]
    with pytest.raises(messages.UnknownTypeError, match=f"did you mean {FOLLOW}"):
        messages.action_type("sfglab_interfaces/action/FollowTrajektory")
