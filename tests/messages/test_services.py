from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.messages import (
    MessageError,
    ServiceFrame,
    default_message,
    frame_service,
    serialize,
    unframe_service,
)


def test_the_header_stands_between_encapsulation_and_fields():
    cdr = serialize(default_message("sfglab_interfaces/srv/GetMetadata_Request"))
    framed = frame_service(ServiceFrame(0x1122334455667788, 9, cdr))
    assert framed == bytes.fromhex("00010000 8877665544332211 0900000000000000 00000000")


@given(st.integers(0, 2**64 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(max_size=40))
def test_a_frame_comes_back(guid, sequence, body):
    frame = ServiceFrame(guid, sequence, b"\0\1\0\0" + body)
    assert unframe_service(frame_service(frame)) == frame


def test_a_big_endian_frame_is_read():
    assert unframe_service(bytes(4) + struct.pack(">Qq", 1, -2) + b"x") == (1, -2, bytes(4) + b"x")


@pytest.mark.parametrize("data", [b"", bytes(19), b"\0\6\0\0" + bytes(16), b"\1\1\0\0" + bytes(16)])
def test_what_has_no_header_is_refused(data):
    with pytest.raises(MessageError, match="rmw_cyclonedds"):
        unframe_service(data)
