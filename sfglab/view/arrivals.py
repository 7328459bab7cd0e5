"""Messages of a domain or a log as a view receives them.

A message stays serialized until a display shows it, so a dropped message costs no decoding. The capture stamp is
read from its place in the bytes.
"""

from __future__ import annotations

import functools
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.messages import decoder, message_type, ns_from_stamp
from sfglab.messages.store import type_store
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from sfglab.record import LogReader

_STAMP = {b"\0\0": struct.Struct(">iI"), b"\0\1": struct.Struct("<iI")}
"""Reader of the stamp in a header, by the encapsulation at the beginning of CDR (RTPS 2.5, clause 10.2): plain CDR, big
and little endian."""

_HEADED = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
_STAMPS = ("header", "stamp", "timestamp")


class Arrival(NamedTuple):
    """One serialized message as a view receives it."""

    topic: str  #: Topic of the message.
    type_name: str  #: ROS type of the message.
    received_ns: int  #: Time of reception, ns, on the clock of this host or of the log.
    cdr: bytes  #: Serialized message; empty if only the decoded message is known.
    message: Any = None  #: Decoded message, if it has been decoded already; otherwise None.


def capture_ns(arrival: Arrival) -> int:
    """Return the capture time of a message, ns: the stamp of its header, or the time of reception if that is zero.

    Messages without a header also have the time of reception.
    """
    if arrival.message is None:
        stamp_ns = _from_bytes(arrival.cdr) if _starts_with_stamp(arrival.type_name) else 0
    else:
        stamp_ns = _from_message(arrival.message)
    return stamp_ns or arrival.received_ns


def decoded(arrival: Arrival) -> Any:
    """Return the decoded message.

    Raises:
        CdrError: The bytes are no message of the type.
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
    return int(seconds) * NS_PER_S + int(nanoseconds)


def _from_message(message: Any) -> int:
    for name in _STAMPS:
        stamp = getattr(message, name, None)
        stamp = getattr(stamp, "stamp", stamp)
        if hasattr(stamp, "nanosec"):
            return ns_from_stamp(stamp)
    return 0


def arrivals_of(log: LogReader, topics: Collection[str]) -> Iterator[Arrival]:
    """Yield the messages of some topics of a log, in the order of reception.

    Types that this process does not know with the same fields are decoded with the definitions in the log.
    """
    foreign = {topic for topic in topics if not log.knows(topic)}
    for entry in log.messages():
        if entry.topic in topics:
            message = log.decode(entry) if entry.topic in foreign else None
            yield Arrival(entry.topic, entry.type_name, entry.log_time_ns, entry.cdr, message)
