import mmap
import struct
import zlib

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from random_messages import random_message
from rosbags.serde import SerdeError

from sfglab import messages
from sfglab.messages import (
    CdrError,
    decoder_from_definition,
    default_message,
    deserialize,
    serialize,
)
from sfglab.messages.store import type_store

IMAGE, TF = "sensor_msgs/msg/Image", "tf2_msgs/msg/TFMessage"
NUMBERS = "std_msgs/msg/Float64MultiArray"
SENSORS = [f"sensor_msgs/msg/{name}" for name in ("PointCloud2", "Imu", "Image", "CameraInfo")]


def image(pixels):
    return default_message(IMAGE, height=1, width=pixels.size, encoding="mono8", data=pixels)


def read_by_rosbags(cdr):
    store = type_store()
    definition = store.get_msgdef(IMAGE)
    decode = definition.deserialize_cdr_le if cdr[1] else definition.deserialize_cdr_be
    return decode(memoryview(cdr).toreadonly()[4:], 0, definition.cls, store)[0]


@given(
    st.text(max_size=5),
    st.text(max_size=9),
    st.binary(max_size=9),
    st.lists(st.tuples(st.integers(0, 70), st.integers(0, 255)), max_size=2),
    st.just(0) | st.integers(1, 60),
)
def test_an_image_is_read_or_refused_as_by_rosbags(frame_id, encoding, pixels, changes, cut_off):
    header = default_message("std_msgs/msg/Header", frame_id=frame_id)
    message = image(np.frombuffer(pixels, np.uint8))
    message.header, message.encoding, message.step = header, encoding, len(pixels)
    cdr = bytearray(serialize(message))
    for place, value in changes:
        cdr[place % len(cdr)] = value
    cdr = cdr[: max(4, len(cdr) - cut_off)]
    assume(bytes(cdr[:2]) in {b"\0\0", b"\0\1"})
    try:
        expected = repr(read_by_rosbags(cdr))
    except (SerdeError, struct.error, ValueError, IndexError):
        with pytest.raises(CdrError):
            deserialize(cdr, IMAGE)
    else:
        assert repr(deserialize(cdr, IMAGE)) == expected


def test_golden_bytes_of_an_agent_heartbeat_and_big_endian_is_read():
    stamp = messages.message_type("builtin_interfaces/msg/Time")(sec=1, nanosec=2)
    heartbeat = messages.message_type("sfglab_interfaces/msg/AgentHeartbeat")(
        stamp=stamp, agent="r1", incarnation=3, revision=4, phase=1, period_s=0.5, version="0"
    )
    assert serialize(heartbeat) == (
        bytes.fromhex("00010000")  # little endian
        + struct.pack("<iI", 1, 2)  # stamp
        + struct.pack("<I", 3)  # length of agent with its end
        + b"r1\0"
        + bytes(1)  # to a multiple of 8, counted after the header
        + struct.pack("<Q", 3)
        + struct.pack("<I", 4)
        + struct.pack("<B", 1)
        + bytes(3)  # to a multiple of 8
        + struct.pack("<d", 0.5)
        + struct.pack("<I", 2)
        + b"0\0"
        + bytes(2)  # to a multiple of 4
    )
    cdr = b"\0\0\0\0" + struct.pack(">iI", 5, 6)
    assert deserialize(cdr, "builtin_interfaces/msg/Time").nanosec == 6


def test_every_type_survives_the_round_trip_and_fits_its_size():
    for name in messages.message_types():
        # Other tests may have added types: each type has its own numbers.
        message = random_message(np.random.default_rng(zlib.crc32(name.encode())), name)
        cdr = serialize(message)
        dirty = bytearray(b"\xff" * (len(cdr) + 3))
        assert serialize(deserialize(cdr, name)) == cdr
        assert len(cdr) % 4 == 0
        assert (
            messages.serialize_into(message, dirty) == len(cdr) == messages.serialized_size(message)
        )
        assert dirty == cdr + b"\xff\xff\xff", name


@pytest.mark.parametrize("container", [bytes, bytearray, memoryview, np.frombuffer, "mmap"])
def test_arrays_are_read_only_views_of_any_buffer(container):
    cdr = serialize(image(np.arange(251, dtype=np.uint8)))
    if container == "mmap":
        data = mmap.mmap(-1, len(cdr))
        data[:] = cdr
    else:
        data = container(cdr, np.uint8) if container is np.frombuffer else container(cdr)
    pixels = deserialize(data, "sensor_msgs/msg/Image").data
    assert np.shares_memory(pixels, np.frombuffer(data, np.uint8))
    assert not pixels.flags.writeable
    assert pixels.tolist() == list(range(251))
    wide = default_message(NUMBERS, data=np.linspace(0, 1, 7))
    cdr = serialize(wide)
    read = deserialize(cdr, type(wide)).data
    assert np.shares_memory(read, np.frombuffer(cdr, np.uint8))
    assert read.tolist() == wide.data.tolist()


@pytest.mark.parametrize(
    ("name", "field", "value", "complaint"),
    [
        (IMAGE, "data", b"abc", r"data: given b'abc', allowed: uint8\[\] as a contiguous NumPy"),
        (IMAGE, "data", [1, 2], r"data: given \[1, 2\]"),
        (IMAGE, "data", np.zeros(3, np.int32), r"data: given an array of int32 and shape \(3,\)"),
        (IMAGE, "data", np.zeros((2, 3), np.uint8), r"an array of uint8 and shape \(2, 3\)"),
        (IMAGE, "height", -1, "height: given -1, allowed: uint32"),
        (IMAGE, "height", 1.5, "height: given 1.5, allowed: uint32"),
        (IMAGE, "encoding", None, "encoding: given None, allowed: string"),
        (IMAGE, "header", None, "header: given None, allowed: std_msgs/msg/Header"),
        (NUMBERS, "data", np.zeros(8)[::2], "allowed: .* a contiguous NumPy array"),
        ("sensor_msgs/msg/JointState", "name", ["a", 3], r"name\[1\]: given 3, allowed: string"),
        (TF, "w", "one", r"transforms\[1\].transform.rotation.w: given 'one'"),
        (
            "sensor_msgs/msg/Imu",
            "angular_velocity_covariance",
            np.zeros(8),
            r"allowed: float64\[9\]",
        ),
        ("std_msgs/msg/Float32", "data", 1e300, "float"),
    ],
)
def test_a_field_that_does_not_fit_is_named_with_its_path(name, field, value, complaint):
    message = holder = default_message(name)
    if name == TF:
        message.transforms = [
            default_message("geometry_msgs/msg/TransformStamped") for _ in range(2)
        ]
        holder = message.transforms[1].transform.rotation
    setattr(holder, field, value)
    with pytest.raises(CdrError, match=complaint) as error:
        serialize(message)
    assert error.value.type_name == name
    with pytest.raises(CdrError):
        messages.serialize_into(message, bytearray(1000))


def test_what_is_no_message_is_refused_and_a_buffer_too_small_is_left_alone():
    with pytest.raises(messages.UnknownTypeError):
        serialize({"data": "x"})
    buffer = bytearray(b"\xff" * 10)
    with pytest.raises(CdrError, match="given a buffer of 10 bytes, needed: "):
        messages.serialize_into(image(np.zeros(3, np.uint8)), buffer)
    assert buffer == b"\xff" * 10


@pytest.mark.parametrize("name", [*SENSORS, TF, "std_msgs/msg/String"])
def test_truncated_bytes_are_an_error_at_every_length(name):
    cdr = serialize(random_message(np.random.default_rng(3), name))
    for length in range(len(cdr) - 3):  # up to three bytes of padding may be missing
        with pytest.raises(CdrError) as error:
            deserialize(cdr[:length], name)
        assert error.value.size_bytes == length


@pytest.mark.parametrize("length", [1, 2**31, 2**32 - 1])
def test_a_hostile_length_allocates_nothing(length):
    cdr = b"\0\1\0\0" + struct.pack("<I", length)
    image = serialize(default_message("sensor_msgs/msg/Image"))[:-4] + cdr[4:]
    with pytest.raises(CdrError):
        deserialize(image, "sensor_msgs/msg/Image")
    for name in (
        "tf2_msgs/msg/TFMessage",
        "std_msgs/msg/String",
        "rcl_interfaces/msg/ListParametersResult",
    ):
        with pytest.raises(CdrError, match=f"given|Invalid|{name}"):
            deserialize(cdr, name)


@pytest.mark.parametrize("head", [b"", b"\0\1", b"\0\6\0\0", b"\0\x0b\0\0"])
def test_other_encapsulations_are_refused(head):
    with pytest.raises(CdrError, match="encapsulation"):
        deserialize(head + bytes(8) if len(head) == 4 else head, "builtin_interfaces/msg/Time")


def test_a_foreign_definition_decodes_its_messages_and_ours_decode_like_our_types():
    text = (
        "int32 x\nother_pkg/Point[] points\n"
        + "=" * 80
        + "\nMSG: other_pkg/Point\nfloat32 a  # metres"
    )
    decode = decoder_from_definition("test_pkg/msg/Foreign", text)
    cdr = b"\0\1\0\0" + struct.pack("<iIff", 7, 2, 0.5, 1.5)
    message = decode(cdr)
    assert (message.x, [p.a for p in message.points]) == (7, [0.5, 1.5])
    with pytest.raises(CdrError, match="test_pkg/msg/Foreign"):
        decode(cdr[:10])
    rng = np.random.default_rng(5)
    for name in (
        "sfglab_interfaces/msg/AgentMetadata",
        "sfglab_interfaces/srv/GetMetadata_Request",
    ):
        cdr = serialize(random_message(rng, name))
        read = decoder_from_definition(name, messages.definition(name))(cdr)
        assert repr(read) == repr(deserialize(cdr, name))


@pytest.mark.parametrize("text", ["int32", "other_pkg/Missing x\n", "int32 x\nint32 x y\n"])
def test_a_definition_that_lacks_something_is_refused(text):
    with pytest.raises(CdrError, match="definition cannot be read"):
        decoder_from_definition("test_pkg/msg/Bad", text)


def test_strings_are_read_as_rclpy_reads_them_and_bytes_behind_a_message_are_ignored():
    string = serialize(default_message("std_msgs/msg/String"))
    empty, endless = (
        string[:4] + struct.pack("<I", length) + b"x\0\0\0" * length for length in (0, 1)
    )
    latin = string[:4] + struct.pack("<I", 2) + b"\xe4\0\0\0"
    assert deserialize(empty, "std_msgs/msg/String").data == ""
    assert deserialize(latin, "std_msgs/msg/String").data == "\ufffd"
    with pytest.raises(CdrError):
        deserialize(endless, "std_msgs/msg/String")
    for name in ("std_msgs/msg/String", "tf2_msgs/msg/TFMessage"):
        message = default_message(name)
        assert deserialize(serialize(message) + b"\0" * 8, name) == message
