from importlib import resources

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from sfglab import messages
from sfglab.messages import (
    MessageError,
    UnknownTypeError,
    dds_type_name,
    default_message,
    message_type,
    ros_type_name,
    service_hash,
    type_hash,
    type_name,
)
from sfglab.messages.store import register, type_store

# Types of ours and of ROS 2; taken at import, before other tests register theirs.
OURS = tuple(name for name in messages.message_types() if "/srv/" not in name)
COPIED = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "header width height encoding pts flags is_bigendian data",
    "foxglove_msgs/msg/CompressedVideo": "timestamp frame_id data format",
    "rmw_dds_common/msg/Gid": "data",
}


# From the JSON files of ROS 2 Jazzy's packages, where a character is hashed as a uint8.
HASHES = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Char": "3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
    "sensor_msgs/msg/PointCloud2": "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
}


@pytest.mark.parametrize(("name", "fields"), COPIED.items())
def test_types_of_other_packages_have_their_fields_in_wire_order(name, fields):
    assert [field for field, _ in type_store().fielddefs[name][1]] == fields.split()


def test_services_have_the_hashes_of_ros_2():
    hash_ = "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"
    assert service_hash("std_srvs/srv/SetBool") == f"RIHS01_{hash_}"
    with pytest.raises(UnknownTypeError):
        service_hash("std_srvs/srv/None")


@pytest.mark.parametrize(("name", "hash_"), HASHES.items())
def test_types_have_the_hashes_of_ros_2(name, hash_):
    assert type_hash(name) == f"RIHS01_{hash_}"


def test_every_line_of_our_interfaces_has_a_comment():
    root = resources.files("sfglab.messages") / "interfaces" / "sfglab_interfaces"
    for folder in (root / kind for kind in ("msg", "srv", "action")):
        for file in folder.iterdir():
            lines = file.read_text("utf-8").splitlines()
            assert all("# " in line for line in lines if line and line != "---"), file.name


def test_a_type_is_known_by_one_spelling_and_a_service_is_its_two_halves():
    assert type_name(message_type("std_msgs/msg/String")) == "std_msgs/msg/String"
    with pytest.raises(
        messages.UnknownTypeError, match="did you mean std_msgs/msg/String"
    ) as error:
        message_type("std_msgs/String")
    assert error.value.near[0] == "std_msgs/msg/String"
    with pytest.raises(LookupError, match="give a name such as"):
        type_name("complete_nonsense")
    with pytest.raises(messages.UnknownTypeError, match="int"):
        type_name(int)
    service = messages.service_type("sfglab_interfaces/srv/GetMetadata")
    assert type_name(service.request) == "sfglab_interfaces/srv/GetMetadata_Request"
    # rosidl gives an empty struct one octet, so that there is something on the wire.
    assert messages.serialize(default_message(service.request)) == b"\0\1\0\0" + b"\0" + b"\0\0\0"
    assert default_message(service.response).metadata.sensors == []
    with pytest.raises(
        messages.UnknownTypeError, match="did you mean sfglab_interfaces/srv/GetMetadata"
    ):
        messages.service_type("sfglab_interfaces/srv/GetMetaData")


def test_definitions_are_what_rosbag2_writes_and_are_read_back_as_the_same_types():
    rule = "=" * 80
    assert messages.definition("sensor_msgs/msg/Image") == (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
        f"uint32 step\nuint8[] data\n{rule}\nMSG: std_msgs/Header\n"
        f"builtin_interfaces/Time stamp\nstring frame_id\n{rule}\n"
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    for name in OURS:
        for read, fields in get_types_from_msg(messages.definition(name), name).items():
            # rosbags gives empty messages their octet only when it registers them.
            assert fields == type_store().fielddefs[read] or not fields[1]


def test_a_default_message_has_the_defaults_of_the_definition_all_the_way_down():
    image = default_message("sensor_msgs/msg/Image")
    assert (image.header.stamp.sec, image.header.frame_id, image.height) == (0, "", 0)
    assert image.data.dtype == np.uint8
    assert image.data.size == 0
    assert default_message("rmw_dds_common/msg/Gid").data.shape == (24,), "as in Humble"
    imu = default_message(message_type("sensor_msgs/msg/Imu"))
    assert imu.orientation_covariance.tolist() == [0.0] * 9
    assert imu.orientation.w == 1.0, "as in rclpy"
    text = (
        'uint8 mode 3\nstring name "dock"  # or "bay"\nfloat32[] gains [1.0, 2.0]\nbool on true\n'
        "int32 MOST=5\nstring<=9 word 'a b'\nint8[2] pair\nuint8 LEAST = 3\nfloat64 low -1.5\n"
        'string[] words ["a", "b"]\ngeometry_msgs/Quaternion turn\n'
    )
    register("test_pkg/msg/Defaults", text)
    made = default_message("test_pkg/msg/Defaults", low=0.0)
    assert (made.mode, made.name, made.on, made.word, made.low) == (3, "dock", True, "a b", 0.0)
    assert (made.gains.tolist(), made.pair.tolist(), made.words) == ([1.0, 2.0], [0, 0], ["a", "b"])
    assert (made.gains.dtype, made.turn.w) == (np.float32, 1.0)
    register("test_pkg/msg/Wrong", "uint8 mode 300\n")
    with pytest.raises(MessageError, match=r"test_pkg/msg/Wrong\.mode: given the default 300"):
        default_message("test_pkg/msg/Wrong")
    assert (
        imu.orientation_covariance
        is not default_message("sensor_msgs/msg/Imu").orientation_covariance
    )


def test_a_name_is_registered_once():
    first = register("test_pkg/msg/Once", "int32 x\n")
    assert register("test_pkg/msg/Once", "int32 x  # the same fields\n") is first
    with pytest.raises(MessageError, match="test_pkg/msg/Once"):
        register("test_pkg/msg/Once", "int32 y\n")


@pytest.mark.parametrize(
    ("ros", "dds"),
    [
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_"),
        ("sensor_msgs/msg/PointCloud2", "sensor_msgs::msg::dds_::PointCloud2_"),
        ("std_srvs/srv/SetBool_Request", "std_srvs::srv::dds_::SetBool_Request_"),
        (
            "nav2_msgs/action/Spin_SendGoal_Response",
            "nav2_msgs::action::dds_::Spin_SendGoal_Response_",
        ),
    ],
)
def test_names_are_mapped_as_rosidl_does_both_ways(ros, dds):
    assert dds_type_name(ros) == dds
    assert ros_type_name(dds) == ros


@pytest.mark.parametrize(
    ("read", "said", "names"),
    [
        (
            dds_type_name,
            "package/msg/Name",
            "std_msgs/String String std_msgs/msg/String_ a/b/msg/C 9a/msg/B",
        ),
        (ros_type_name, "dds_", "std_msgs::msg::String DDS::Time std_msgs::msg::dds_::String bool"),
    ],
)
def test_other_forms_and_types_of_other_dds_applications_are_no_ros_types(read, said, names):
    for name in ("", *names.split()):
        with pytest.raises(messages.TypeNameError, match=said):
            read(name)


@given(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_stamps_are_exact_to_the_nanosecond(stamp_ns):
    stamp = messages.stamp_from_ns(stamp_ns)
    assert 0 <= stamp.nanosec < 10**9
    assert messages.ns_from_stamp(stamp) == stamp_ns
