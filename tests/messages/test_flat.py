"""The generated readers read what the general decoder reads, and refuse what it refuses."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from sfglab.messages import CdrError, decoder, default_message, deserialize, message_types, serialize
from sfglab.messages.flat import flat_reader
from sfglab.messages.store import type_store

FLAT = [name for name in message_types() if flat_reader(type_store(), name)]


def filled(name: str, rng: np.random.Generator):
    """A message with random numbers, strings of all lengths modulo 8, and arrays that may be empty."""
    message = default_message(name)
    fill(message, rng)
    return message


def fill(message, rng) -> None:
    for field, desc in type_store().fielddefs[message.__msgtype__][1]:
        value = getattr(message, field)
        if hasattr(value, "__msgtype__"):
            fill(value, rng)
        elif isinstance(value, str):
            setattr(message, field, "abcdefghi"[: rng.integers(0, 9)])
        elif isinstance(value, np.ndarray):
            is_sequence = desc[0].name == "SEQUENCE"
            length = int(rng.integers(0, 4)) if is_sequence else len(value)
            numbers = rng.integers(0, 2 if value.dtype == bool else 100, length)
            setattr(message, field, numbers.astype(value.dtype))
        elif isinstance(value, bool):
            setattr(message, field, bool(rng.integers(0, 2)))
        else:
            setattr(message, field, type(value)(rng.integers(0, 100)))


def test_the_messages_of_sensors_are_flat():
    assert {"sensor_msgs/msg/Image", "sensor_msgs/msg/Imu", "sensor_msgs/msg/CameraInfo"} <= set(FLAT)
    assert "ffmpeg_image_transport_msgs/msg/FFMPEGPacket" in FLAT
    assert "tf2_msgs/msg/TFMessage" not in FLAT
    assert len(FLAT) > 80


@pytest.mark.parametrize("name", FLAT)
def test_what_is_read_is_what_the_general_decoder_reads(name):
    rng = np.random.default_rng(1)
    for _ in range(8):
        data = serialize(filled(name, rng))
        read = flat_reader(type_store(), name)(memoryview(data))
        assert serialize(read) == serialize(type_store().deserialize_cdr(data, name)) == data


@pytest.mark.parametrize("name", ["sensor_msgs/msg/Image", "sensor_msgs/msg/Imu", "sensor_msgs/msg/CameraInfo"])
def test_every_truncation_is_refused(name):
    data = serialize(filled(name, np.random.default_rng(3)))
    whole = len(data) - 3  # up to three bytes of padding may be missing
    for end in range(whole):
        with pytest.raises(CdrError):
            decoder(name)(data[:end])


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


def test_arrays_are_views_of_the_bytes():
    image = default_message("sensor_msgs/msg/Image")
    image.data = np.arange(50, dtype=np.uint8)
    data = bytearray(serialize(image))
    seen = deserialize(data, "sensor_msgs/msg/Image").data
    assert not seen.flags.writeable
    data[-3] = 77
    assert 77 in seen
