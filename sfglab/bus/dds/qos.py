"""`QoSProfile` to and from Cyclone's QoS objects."""

from __future__ import annotations

import ctypes as ct
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypedDict

from sfglab.bus.dds.clib import INFINITY_NS, library
from sfglab.qos import Durability, History, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Unpack


_RELIABILITY = (Reliability.BEST_EFFORT, Reliability.RELIABLE)
_HISTORY = (History.KEEP_LAST, History.KEEP_ALL)
_DURABILITY = (Durability.VOLATILE, Durability.TRANSIENT_LOCAL)
_UNLIMITED = -1
_IGNORE_PARTICIPANT = 1  # enum dds_ignorelocal_kind
# How long a writer that keeps all may block on unacknowledged samples: Cyclone's default.
_MAX_BLOCKING_NS = 100_000_000


@contextmanager
def qos_object(user_data: bytes = b"") -> Iterator[int]:
    """Yield a C QoS object that is freed afterwards."""
    lib = library()
    qos = lib.dds_create_qos()
    try:
        if user_data:
            lib.dds_qset_userdata(qos, user_data, len(user_data))
        yield qos
    finally:
        lib.dds_delete_qos(qos)


class EndpointOptions(TypedDict, total=False):
    """What a reader or writer may have beside its profile; see `endpoint_qos`."""

    user_data: bytes
    partition: str
    ignore_local: bool
    max_samples: int
    batching: bool
    max_blocking_ns: int


@contextmanager
def endpoint_qos(profile: QoSProfile, **more: Unpack[EndpointOptions]) -> Iterator[int]:
    """Yield the C QoS object of a reader or writer.

    Args:
        profile: In ROS 2's terms.
        more: USER_DATA; a PARTITION; whether it never matches endpoints of its own participant; how many
            samples a reader that keeps all may hold, after which senders wait for it; whether a writer sends
            only when it is flushed or a packet is full; how long it may block when it keeps all.
    """
    lib = library()
    history = _HISTORY.index(profile.history)
    depth = profile.depth if profile.history is History.KEEP_LAST else _UNLIMITED
    with qos_object(more.get("user_data", b"")) as qos:
        max_blocking_ns = more.get("max_blocking_ns", _MAX_BLOCKING_NS)
        lib.dds_qset_reliability(qos, _RELIABILITY.index(profile.reliability), max_blocking_ns)
        lib.dds_qset_durability(qos, _DURABILITY.index(profile.durability))
        lib.dds_qset_history(qos, history, depth)
        # What a late joiner gets is a policy of its own in DDS; ROS 2 ties it to the history.
        lib.dds_qset_durability_service(qos, 0, history, depth, _UNLIMITED, _UNLIMITED, _UNLIMITED)
        lib.dds_qset_deadline(qos, _or_infinite(profile.deadline_ns))
        lib.dds_qset_lifespan(qos, _or_infinite(profile.lifespan_ns))
        lib.dds_qset_writer_data_lifecycle(qos, False)
        if partition := more.get("partition"):
            lib.dds_qset_partition1(qos, partition.encode())
        if more.get("ignore_local"):
            lib.dds_qset_ignorelocal(qos, _IGNORE_PARTICIPANT)
        if more.get("batching"):
            lib.dds_qset_writer_batching(qos, True)
        if max_samples := more.get("max_samples"):
            lib.dds_qset_resource_limits(qos, max_samples, _UNLIMITED, _UNLIMITED)
        yield qos


def profile_from_dds(qos: int) -> QoSProfile:
    """Return what a discovered endpoint's QoS says; policies it leaves out have DDS's defaults."""
    lib = library()
    reliability, durability, history, depth = ct.c_int(), ct.c_int(), ct.c_int(), ct.c_int32(1)
    blocking, deadline, lifespan = ct.c_int64(), ct.c_int64(INFINITY_NS), ct.c_int64(INFINITY_NS)
    lib.dds_qget_reliability(qos, ct.byref(reliability), ct.byref(blocking))
    lib.dds_qget_durability(qos, ct.byref(durability))
    lib.dds_qget_history(qos, ct.byref(history), ct.byref(depth))
    lib.dds_qget_deadline(qos, ct.byref(deadline))
    lib.dds_qget_lifespan(qos, ct.byref(lifespan))
    return QoSProfile(
        reliability=_RELIABILITY[reliability.value],
        # DDS knows TRANSIENT and PERSISTENT above TRANSIENT_LOCAL; ROS 2 does not.
        durability=_DURABILITY[min(durability.value, 1)],
        history=_HISTORY[history.value],
        depth=max(depth.value, 1),
        deadline_ns=_or_none(deadline.value),
        lifespan_ns=_or_none(lifespan.value),
    )


def user_data(qos: int) -> bytes:
    """Return a QoS object's USER_DATA."""
    lib = library()
    value, size = ct.c_void_p(), ct.c_size_t()
    if not lib.dds_qget_userdata(qos, ct.byref(value), ct.byref(size)) or not value.value:
        return b""
    try:
        return ct.string_at(value.value, size.value)
    finally:
        lib.dds_free(value)


def partitions(qos: int) -> tuple[str, ...]:
    """Return a QoS object's PARTITION names."""
    lib = library()
    count, names = ct.c_uint32(), ct.POINTER(ct.c_void_p)()
    if not lib.dds_qget_partition(qos, ct.byref(count), ct.byref(names)) or not names:
        return ()
    try:
        return tuple(ct.string_at(names[i] or 0).decode(errors="replace") for i in range(count.value))
    finally:
        for i in range(count.value):
            lib.dds_free(names[i])
        lib.dds_free(names)


def string_property(qos: int, name: str) -> str:
    """Return one of a participant's properties, empty when it has none of that name."""
    lib = library()
    value = ct.c_void_p()
    if not lib.dds_qget_prop(qos, name.encode(), ct.byref(value)) or not value.value:
        return ""
    try:
        return ct.string_at(value.value).decode(errors="replace")
    finally:
        lib.dds_free(value)


def _or_infinite(duration_ns: int | None) -> int:
    return INFINITY_NS if duration_ns is None else duration_ns


def _or_none(duration_ns: int) -> int | None:
    return None if duration_ns >= INFINITY_NS or duration_ns <= 0 else duration_ns
