"""Requests and replies as rmw_cyclonedds frames them: 16 bytes that say who asked, in front of the fields.

Knows the frame (rmw_cyclonedds, `cdds_request_header_t`). Refuses to know sockets; note that rmw_fastrtps has
no such frame, so the two do not understand each other's services.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from sfglab.errors import SfglabError

_ENCAPSULATION_BYTES = 4
_FRAME = {0: struct.Struct(">Qq"), 1: struct.Struct("<Qq")}  # by the second octet of the encapsulation


class ServiceFrameError(SfglabError, ValueError):
    """Bytes that carry no service header.

    Attributes:
        size_bytes: Length of what was given.
    """

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes = size_bytes
        super().__init__(
            f"service frame: given {size_bytes} bytes, allowed are CDR bytes with a header of 16: "
            "does the peer run rmw_cyclonedds?"
        )


class ServiceFrame(NamedTuple):
    """One request or reply, taken apart.

    Attributes:
        client_guid: Which client asked; a reply repeats it.
        sequence: Which of its requests; a reply repeats it.
        cdr: The request or response alone, as `deserialize` takes it.
    """

    client_guid: int
    sequence: int
    cdr: bytes


def frame_service(frame: ServiceFrame) -> bytes:
    """Return the bytes that go to DDS: encapsulation, guid, sequence number, fields.

    Args:
        frame: The two numbers and a request or response as `serialize` returns it.

    Returns:
        CDR of the type that `sfglab.messages.dds.service_idl_struct` makes. 16 bytes keep every alignment.
    """
    header = _FRAME[1].pack(frame.client_guid, frame.sequence)
    return b"".join((frame.cdr[:_ENCAPSULATION_BYTES], header, frame.cdr[_ENCAPSULATION_BYTES:]))


def unframe_service(data: bytes) -> ServiceFrame:
    """Return the parts of a request or reply that came from DDS.

    Args:
        data: What `frame_service` returns, in either byte order.

    Returns:
        The two numbers and the plain CDR.

    Raises:
        ServiceFrameError: Too short, or not CDR.
    """
    start = _ENCAPSULATION_BYTES
    end = start + _FRAME[1].size
    if len(data) < end or data[0] != 0 or data[1] not in _FRAME:
        raise ServiceFrameError(len(data))
    client_guid, sequence = _FRAME[data[1]].unpack_from(data, start)
    return ServiceFrame(client_guid, sequence, data[:start] + data[end:])
