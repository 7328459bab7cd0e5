"""Bytes that the RTPS of Cyclone DDS puts on an Ethernet, sizes only, and their sums by what they are for.

Submessages (RTPS 2.5, clause 9.4), parameter lists (clause 9.6.3), and the packets of Cyclone DDS 11.0.1 as
captured between network namespaces. Sizes are bytes of Ethernet frames without checksums.
"""

from __future__ import annotations

import operator
from dataclasses import astuple, dataclass
from enum import IntEnum
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, Self

from sfglab.messages.store import type_store
from sfglab.messages.type_names import announced_type_name
from sfglab.qos import Durability, History, Liveliness, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.bus.api import EndpointInfo


class Load(IntEnum):
    """What bytes are for: the fields of `KindBytes`."""

    DATA = 0
    ACKS = 1
    DISCOVERY = 2
    DISCOVERY_ACKS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class KindBytes:
    """Bytes of Ethernet frames in one direction, by what they were for."""

    data: int = 0  #: Samples, with the heartbeats in their packets.
    acks: int = 0  #: Heartbeats and acknowledgements of samples.
    discovery: int = 0  #: Announcements of participants and endpoints, and of liveliness.
    discovery_acks: int = 0  #: Heartbeats and acknowledgements of discovery.

    @property
    def total(self) -> int:
        """All of them."""
        return sum(astuple(self))

    @classmethod
    def of(cls, counts: Iterable[int]) -> Self:
        """Return counts by `Load` as a value."""
        return cls(**{load.name.lower(): count for load, count in zip(Load, counts, strict=True)})

    def since(self, earlier: KindBytes) -> KindBytes:
        """Return what has come on top of an earlier count."""
        return KindBytes.of(map(operator.sub, astuple(self), astuple(earlier)))


@dataclass(frozen=True, slots=True, kw_only=True)
class HostTraffic:
    """What one host's interface to the network has carried."""

    rx: KindBytes = KindBytes()  #: Into the host.
    tx: KindBytes = KindBytes()  #: Out of it.

    def since(self, earlier: HostTraffic) -> HostTraffic:
        """Return what has come on top of an earlier count."""
        return HostTraffic(rx=self.rx.since(earlier.rx), tx=self.tx.since(earlier.tx))


_ETHERNET, _IP, _UDP = 14, 20, 8
_MTU_PAYLOAD = 1480  # of an IP fragment: 1500 - 20
_RTPS, _INFO_DST, _INFO_TS = 20, 16, 12
_DATA, _DATA_FRAG, _HEARTBEAT, _ACKNACK = 24, 36, 32, 28
_ENCAPSULATION = 4
_PARTITION = 4 + 4 + 4 + 12
# Cyclone's General/MaxMessageSize; a sample that does not fit goes in pieces of ten fragments of 1344 B.
_MAX_MESSAGE = 14720
_PIECE = 13440


def _frames(payload: int) -> int:
    """Return the size of a UDP datagram in frames; one above the MTU goes as IP fragments."""
    datagram = _UDP + payload
    return datagram + -(-datagram // _MTU_PAYLOAD) * (_ETHERNET + _IP)


HEARTBEAT_BYTES = _frames(_RTPS + _HEARTBEAT)
ACKNACK_BYTES = _frames(_RTPS + _INFO_DST + _ACKNACK)
LIVELINESS_BYTES = _frames(_RTPS + _INFO_TS + 52 + _HEARTBEAT)
"""A participant message, which asserts the liveliness of all of a participant's writers, with its heartbeat."""

RETRACTION_BYTES = _frames(_RTPS + _INFO_TS + 64)  #: An endpoint's dispose: key and status.
MATCH_BYTES = _frames(_RTPS + _INFO_DST + _HEARTBEAT)  #: A reliable writer's first one to a reader.
MATCH_ACKS_BYTES = 2 * ACKNACK_BYTES  #: The reader's answers, one unasked; captured were 1 to 2.
DISCOVERY_INFO_BYTES = 380  #: The DATA submessage that announces a writer of `ros_discovery_info`.

# Cyclone's Internal/MaxRexmitMessageSize: how much repeated data shares a packet
_SEDP_PACKET = 1456

HELLO_ROUND_BYTES = _frames(_RTPS + _HEARTBEAT) + _frames(_RTPS + 2 * _HEARTBEAT)
"""What each known participant multicasts when another one appears: heartbeats of its empty built-in writers."""

HELLO_ROUND_ACKS_BYTES = _frames(_RTPS + _INFO_DST + 3 * _ACKNACK)  #: What everybody answers to it.


def data_bytes(cdr_bytes: int, *, reliable: bool) -> int:
    """Return the size of a sample with so much CDR, header included; a reliable one carries a heartbeat."""
    tail = _HEARTBEAT if reliable else 0
    whole = _RTPS + _INFO_TS + _DATA + cdr_bytes + -cdr_bytes % 4 + tail
    if whole <= _MAX_MESSAGE:
        return _frames(whole)
    pieces, rest = divmod(cdr_bytes, _PIECE)
    overhead = _RTPS + _INFO_TS + _DATA_FRAG
    total = pieces * _frames(overhead + _PIECE)
    return total + (_frames(overhead + rest + tail) if rest else 0)


def history_bytes(cdr_bytes: int) -> tuple[int, int]:
    """Return what a late joiner costs for each latched sample: writer to reader, and reader to writer."""
    body = _RTPS + _INFO_DST + _INFO_TS + _DATA + cdr_bytes + -cdr_bytes % 4 + _HEARTBEAT
    return _frames(body), ACKNACK_BYTES + 4 + ACKNACK_BYTES


def announcement_bytes(submessage: int) -> int:
    """Return the size of an endpoint's SEDP announcement, given that of its DATA submessage."""
    return _frames(_RTPS + _INFO_TS + submessage)


def retold_bytes(submessages: list[int]) -> int:
    """Return the size of repeated announcements, packed together, from their `submessage_bytes`."""
    room = _SEDP_PACKET - _RTPS - _INFO_DST - _HEARTBEAT
    total = packed = 0
    for submessage in submessages:
        size = _INFO_TS + submessage
        if packed and packed + size > room:
            total += _frames(_RTPS + _INFO_DST + packed)
            packed = 0
        packed += size
    return total + (_frames(_RTPS + _INFO_DST + packed + _HEARTBEAT) if packed else 0)


@lru_cache(maxsize=4096)
def presentation_bytes(user_data: bytes) -> int:
    """Return the size of a periodic SPDP announcement of a participant with this USER_DATA."""
    return _frames(_RTPS + _INFO_DST + _INFO_TS + _participant_submessage(user_data))


def acquaintance_bytes(user_data: bytes) -> tuple[int, int, int]:
    """Return what a newcomer multicasts once, what a participant that it meets sends to it, and the answer.

    Captured: SPDP twice in one packet and heartbeats of five built-in writers; four times SPDP within 3 s,
    three heartbeats, two acknowledgements and the participant message; five acknowledgements, two of them for
    all five, and its own participant message.
    """
    spdp = _participant_submessage(user_data)
    five_heartbeats, five_acks = _RTPS + 5 * _HEARTBEAT, _RTPS + _INFO_DST + 5 * _ACKNACK + 8
    own_liveliness = _frames(_RTPS + _INFO_DST + _INFO_TS + 52 + _HEARTBEAT)
    multicast = _frames(_RTPS + _INFO_DST + 2 * (_INFO_TS + spdp)) + _frames(five_heartbeats)
    to_newcomer = (
        4 * _frames(_RTPS + _INFO_DST + _INFO_TS + spdp)
        + _frames(_INFO_DST + five_heartbeats)
        + 2 * MATCH_BYTES
        + _frames(five_acks)
        + 2 * ACKNACK_BYTES
        + _INFO_TS
        + 52
    )
    from_newcomer = 2 * _frames(five_acks) + 2 * ACKNACK_BYTES + own_liveliness
    return multicast, to_newcomer, from_newcomer


def departure_bytes() -> int:
    """Return the size of a participant's SPDP dispose."""
    return _frames(_RTPS + _INFO_DST + _INFO_TS + 64)


def submessage_bytes(info: EndpointInfo) -> int:
    """Return the size of the DATA submessage of an endpoint, as Cyclone sends it.

    Policies with DDS's default value are left out (RTPS 2.5, clause 9.6.3.1), so the size depends on them.
    """
    writer = info.kind.value == "publisher"
    size = _DATA + _ENCAPSULATION + _text(info.dds_topic) + _text(announced_type_name(info.type))
    size += _qos(info.qos, writer=writer)
    size += _bytes(info.user_data) + (_PARTITION if info.transport == "shm" else 0)
    size += 4 + _type_information(info.type)
    # Protocol version, vendor, GUID, Cyclone's receive buffer (0x8019 or 0x800c) and the end of the list.
    size += 8 + 8 + 20 + 8 + 4
    # Writers add Cyclone's 0x8003; readers the data representations that they accept.
    return size + (8 if writer else 12)


def _participant_submessage(user_data: bytes) -> int:
    fixed = _DATA + _ENCAPSULATION
    # Lease, properties (process name and number), version, vendor, GUID, built-in endpoints, domain id.
    fixed += 12 + 92 + 8 + 8 + 20 + 8 + 8
    # Four locators, Cyclone's own version information, its receive buffer, the end of the list.
    return fixed + 4 * 28 + 52 + 8 + 4 + _bytes(user_data)


def _text(text: str) -> int:
    length = len(text.encode()) + 1
    return 4 + 4 + length + -length % 4


def _bytes(data: bytes) -> int:
    return 4 + 4 + len(data) + -len(data) % 4 if data else 0


def _qos(qos: QoSProfile, *, writer: bool) -> int:
    kept = qos.history is not History.KEEP_LAST or qos.depth != 1
    size = 8 if qos.durability is Durability.TRANSIENT_LOCAL else 0
    size += 12 if kept else 0
    size += 32 if writer and kept else 0  # the durability service, which repeats the history
    # RELIABLE is a writer's default and not a reader's.
    size += 16 if (qos.reliability is Reliability.RELIABLE) is not writer else 0
    size += 12 if qos.deadline_ns is not None else 0
    size += 16 if qos.lease_ns is not None or qos.liveliness is not Liveliness.AUTOMATIC else 0
    return size + (12 if writer and qos.lifespan_ns is not None else 0)


@cache
def _type_information(type_: str) -> int:
    """Return the size of the XTypes information, which lists hashes of the type and of all types in it."""
    return 100 + 48 * len(_inner_types(type_))


def _inner_types(type_: str) -> set[str]:
    """Return the names of all types in a type, at any depth."""
    found: set[str] = set()
    open_ = [type_]
    while open_:
        _, fields = type_store().fielddefs.get(open_.pop(), ((), ()))
        for _, desc in fields:
            if (name := _named(desc)) and name not in found:
                found.add(name)
                open_.append(name)
    return found


def _named(desc: Any) -> str:
    """Return the type that a field, or the elements of one, are of; empty for numbers and text."""
    from rosbags.interfaces import Nodetype

    kind, inner = desc
    if kind in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        kind, inner = inner[0]
    return str(inner) if kind == Nodetype.NAME else ""
