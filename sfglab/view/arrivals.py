"""A message as it arrives from anywhere: its bytes or itself, its topic and its times.

Pure. Bytes stay bytes until somebody wants to see them, so a message that is passed over costs no decoding;
the capture stamp is read from where it stands in the bytes.
"""

from __future__ import annotations

import functools
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.messages import decoder, message_type, ns_from_stamp
from sfglab.messages.store import type_store

if TYPE_CHECKING:
    from collections.abc import Callable


_STAMP = {b"\0\0": struct.Struct(">iI"), b"\0\1": struct.Struct("<iI")}
"""By the encapsulation that CDR begins with (OMG RTPS 2.5, clause 10.2): plain CDR, big and little endian."""

_HEADED = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
_STAMPS = ("header", "stamp", "timestamp")


class Arrival(NamedTuple):
    """One message.

    Attributes:
        topic: Its topic.
        type_name: Its ROS type.
        received_ns: When it arrived, on this host's or the log's clock.
        cdr: Its bytes; empty where only the message is known.
        message: Decoded, where that had to be done already.
    """

    topic: str
    type_name: str
    received_ns: int
    cdr: bytes
    message: Any = None


def capture_ns(arrival: Arrival) -> int:
    """Return when a message was captured; without a stamp, or with one of zero, when it was received."""
    if arrival.message is None:
        stamp_ns = _from_bytes(arrival.cdr) if _starts_with_stamp(arrival.type_name) else 0
    else:
        stamp_ns = _from_message(arrival.message)
    return stamp_ns or arrival.received_ns


def decoded(arrival: Arrival) -> Any:
    """Return the message.

    Raises:
        CdrError: The bytes are not of the type.
        UnknownTypeError: There is no such type.
    """
    return _decoder(arrival.type_name)(arrival.cdr) if arrival.message is None else arrival.message


@functools.cache
def _decoder(type_name: str) -> Callable[[bytes], Any]:
    return decoder(message_type(type_name))


@functools.cache
def _starts_with_stamp(type_name: str) -> bool:
    from rosbags.interfaces import Nodetype

    fields = type_store().get_msgdef(type_name).fields
    return bool(fields) and fields[0][1][0] == Nodetype.NAME and fields[0][1][1] in _HEADED


def _from_bytes(cdr: bytes) -> int:
    layout = _STAMP.get(bytes(cdr[:2]))
    if layout is None or len(cdr) < 12:
        return 0
    seconds, nanoseconds = layout.unpack_from(cdr, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _from_message(message: Any) -> int:
    for name in _STAMPS:
        stamp = getattr(message, name, None)
        stamp = getattr(stamp, "stamp", stamp)
        if hasattr(stamp, "nanosec"):
            return ns_from_stamp(stamp)
    return 0
