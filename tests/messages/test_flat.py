"""The generated readers read what the general decoder reads, and refuse what it refuses."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from sfglab.messages import CdrError, default_message, deserialize, message_types, serialize
from sfglab.messages.flat import flat_reader
from sfglab.messages.store import type_store

FLAT = [name for name in message_types() if flat_reader(type_store(), name)]


def test_the_messages_of_sensors_are_flat():
    assert {"sensor_msgs/msg/Image", "sensor_msgs/msg/Imu", "sensor_msgs/msg/CameraInfo"} <= set(FLAT)
    assert "ffmpeg_image_transport_msgs/msg/FFMPEGPacket" in FLAT
    assert "tf2_msgs/msg/TFMessage" not in FLAT
    assert len(FLAT) > 80


@pytest.mark.parametrize("name", FLAT)
def test_what_is_read_is_what_the_general_decoder_reads(name, random_message):
    rng = np.random.default_rng(1)
    for _ in range(8):
        data = serialize(random_message(rng, name))
        read = flat_reader(type_store(), name)(memoryview(data))
        assert serialize(read) == serialize(type_store().deserialize_cdr(data, name)) == data


def test_a_string_without_end_a_wild_count_and_trailing_bytes_are_refused():
    string = serialize(default_message("std_msgs/msg/String"))
    for broken in (
        string[:4] + struct.pack("<I", 0),
        string[:4] + struct.pack("<I", 2**32 - 1) + b"\0" * 8,
        string[:4] + struct.pack("<I", 1) + b"x\0\0\0",
        string + b"\0" * 8,
    ):
        with pytest.raises(CdrError):
            deserialize(broken, "std_msgs/msg/String")
    image = bytearray(serialize(default_message("sensor_msgs/msg/Image")))
    image[-4:] = struct.pack("<I", 2**31)
    with pytest.raises(CdrError):
        deserialize(image, "sensor_msgs/msg/Image")
