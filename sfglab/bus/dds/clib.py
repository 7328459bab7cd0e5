"""Part of Cyclone DDS's C API that the bus uses, with ctypes: functions, struct layouts and QoS objects.

The library is that of the `cyclonedds` wheel (11.0; headers dds.h, ddsi_serdata.h). The Python API of the wheel
holds the interpreter lock for each whole read or write, and (de)serializes thousands of times slower.
"""

from __future__ import annotations

import ctypes as ct
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, TypedDict

from sfglab.qos import Durability, History, Liveliness, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Unpack

INFINITY_NS = 2**63 - 1
ANY_STATE = 0x7F  # any sample, view and instance state (dds.h)
ALIVE = 16  # DDS_ALIVE_INSTANCE_STATE
SDK_DATA = 2  # enum ddsi_serdata_kind
RETCODE_ERROR = -1
RETCODE_TIMEOUT = -10
STATUS_SAMPLE_LOST = 1 << 5
STATUS_LIVELINESS_CHANGED = 1 << 10
STATUS_PUBLICATION_MATCHED = 1 << 11
STATUS_SUBSCRIPTION_MATCHED = 1 << 12
BUILTIN_PARTICIPANT = 0x7FFF0001
BUILTIN_PUBLICATION = 0x7FFF0003
BUILTIN_SUBSCRIPTION = 0x7FFF0004
# struct ddsi_serdata: ops, hash, refcount, kind, type, then the source timestamp. `ddsi_serdata_init` sets
# the timestamp to an invalid value, which the writer checks before it trusts this offset.
TIMESTAMP_OFFSET = 32
TIMESTAMP_INVALID = -(2**63)


class SampleInfo(ct.Structure):
    """C struct `dds_sample_info_t`: state, source timestamp and writer of a sample."""

    _fields_ = (
        ("sample_state", ct.c_uint),
        ("view_state", ct.c_uint),
        ("instance_state", ct.c_uint),
        ("valid_data", ct.c_bool),
        ("source_timestamp", ct.c_int64),
        ("instance_handle", ct.c_uint64),
        ("publication_handle", ct.c_uint64),
        ("disposed_generation_count", ct.c_uint32),
        ("no_writers_generation_count", ct.c_uint32),
        ("sample_rank", ct.c_uint32),
        ("generation_rank", ct.c_uint32),
        ("absolute_generation_rank", ct.c_uint32),
    )


class IoVec(ct.Structure):
    """C struct `ddsrt_iovec_t`: address and length of a block of memory."""

    _fields_ = (("base", ct.c_void_p), ("size", ct.c_size_t))


class Endpoint(ct.Structure):
    """C struct `dds_builtintopic_endpoint_t`: a discovered endpoint."""

    _fields_ = (
        ("key", ct.c_uint8 * 16),
        ("participant_key", ct.c_uint8 * 16),
        ("participant_instance_handle", ct.c_uint64),
        ("topic_name", ct.c_char_p),
        ("type_name", ct.c_char_p),
        ("qos", ct.c_void_p),
    )


class Participant(ct.Structure):
    """C struct `dds_builtintopic_participant_t`: a discovered participant."""

    _fields_ = (("key", ct.c_uint8 * 16), ("qos", ct.c_void_p))


class MatchedStatus(ct.Structure):
    """C structs `dds_publication_matched_status_t` and `dds_subscription_matched_status_t`, which are alike."""

    _fields_ = (
        ("total_count", ct.c_uint32),
        ("total_count_change", ct.c_int32),
        ("current_count", ct.c_uint32),
        ("current_count_change", ct.c_int32),
        ("last_handle", ct.c_uint64),
    )


class LivelinessStatus(ct.Structure):
    """C struct `dds_liveliness_changed_status_t`: a publisher became alive or lost its liveliness."""

    _fields_ = (
        ("alive_count", ct.c_uint32),
        ("not_alive_count", ct.c_uint32),
        ("alive_count_change", ct.c_int32),
        ("not_alive_count_change", ct.c_int32),
        ("last_handle", ct.c_uint64),
    )


class SampleLostStatus(ct.Structure):
    """C struct `dds_sample_lost_status_t`: number of samples that a reader lost."""

    _fields_ = (("total_count", ct.c_uint32), ("total_count_change", ct.c_int32))


_I32, _U32, _I64, _U64 = ct.c_int32, ct.c_uint32, ct.c_int64, ct.c_uint64
_PTR, _STR, _SIZE, _BOOL = ct.c_void_p, ct.c_char_p, ct.c_size_t, ct.c_bool

# Function -> (result, arguments). Out parameters are plain pointers, given with `byref`.
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "dds_create_domain": (_I32, (_U32, _STR)),
    "dds_create_participant": (_I32, (_U32, _PTR, _PTR)),
    "dds_create_reader": (_I32, (_I32, _I32, _PTR, _PTR)),
    "dds_create_writer": (_I32, (_I32, _I32, _PTR, _PTR)),
    "dds_create_readcondition": (_I32, (_I32, _U32)),
    "dds_create_guardcondition": (_I32, (_I32,)),
    "dds_create_waitset": (_I32, (_I32,)),
    "dds_delete": (_I32, (_I32,)),
    "dds_get_guid": (_I32, (_I32, _PTR)),
    "dds_set_status_mask": (_I32, (_I32, _U32)),
    "dds_set_guardcondition": (_I32, (_I32, _BOOL)),
    "dds_take_guardcondition": (_I32, (_I32, _PTR)),
    "dds_waitset_attach": (_I32, (_I32, _I32, ct.c_ssize_t)),
    "dds_waitset_detach": (_I32, (_I32, _I32)),
    "dds_waitset_wait": (_I32, (_I32, _PTR, _SIZE, _I64)),
    "dds_take": (_I32, (_I32, _PTR, _PTR, _SIZE, _U32)),
    "dds_return_loan": (_I32, (_I32, _PTR, _I32)),
    "dds_takecdr": (_I32, (_I32, _PTR, _U32, _PTR, _U32)),
    "dds_forwardcdr": (_I32, (_I32, _PTR)),
    "dds_write_flush": (_I32, (_I32,)),
    "dds_wait_for_acks": (_I32, (_I32, _I64)),
    "dds_get_entity_sertype": (_I32, (_I32, _PTR)),
    "dds_get_publication_matched_status": (_I32, (_I32, _PTR)),
    "dds_get_subscription_matched_status": (_I32, (_I32, _PTR)),
    "dds_get_sample_lost_status": (_I32, (_I32, _PTR)),
    "dds_get_liveliness_changed_status": (_I32, (_I32, _PTR)),
    "dds_get_matched_subscriptions": (_I32, (_I32, _PTR, _SIZE)),
    "dds_get_matched_publications": (_I32, (_I32, _PTR, _SIZE)),
    "dds_get_matched_subscription_data": (ct.POINTER(Endpoint), (_I32, _U64)),
    "dds_get_matched_publication_data": (ct.POINTER(Endpoint), (_I32, _U64)),
    "dds_builtintopic_free_endpoint": (None, (_PTR,)),
    "ddsi_serdata_from_ser_iov": (_PTR, (_PTR, ct.c_int, _SIZE, _PTR, _SIZE)),
    "ddsi_serdata_size": (_U32, (_PTR,)),
    "ddsi_serdata_to_ser_ref": (_PTR, (_PTR, _SIZE, _SIZE, _PTR)),
    "ddsi_serdata_to_ser_unref": (None, (_PTR, _PTR)),
    "ddsi_serdata_ref": (_PTR, (_PTR,)),
    "ddsi_serdata_unref": (None, (_PTR,)),
    "dds_create_qos": (_PTR, ()),
    "dds_delete_qos": (None, (_PTR,)),
    "dds_qset_reliability": (None, (_PTR, ct.c_int, _I64)),
    "dds_qset_durability": (None, (_PTR, ct.c_int)),
    "dds_qset_durability_service": (None, (_PTR, _I64, ct.c_int, _I32, _I32, _I32, _I32)),
    "dds_qset_history": (None, (_PTR, ct.c_int, _I32)),
    "dds_qset_deadline": (None, (_PTR, _I64)),
    "dds_qset_lifespan": (None, (_PTR, _I64)),
    "dds_qset_liveliness": (None, (_PTR, ct.c_int, _I64)),
    "dds_qset_userdata": (None, (_PTR, _PTR, _SIZE)),
    "dds_qset_partition1": (None, (_PTR, _STR)),
    "dds_qset_ignorelocal": (None, (_PTR, ct.c_int)),
    "dds_qset_writer_batching": (None, (_PTR, _BOOL)),
    "dds_qset_resource_limits": (None, (_PTR, _I32, _I32, _I32)),
    "dds_qset_writer_data_lifecycle": (None, (_PTR, _BOOL)),
    "dds_qget_reliability": (_BOOL, (_PTR, _PTR, _PTR)),
    "dds_qget_durability": (_BOOL, (_PTR, _PTR)),
    "dds_qget_history": (_BOOL, (_PTR, _PTR, _PTR)),
    "dds_qget_durability_service": (_BOOL, (_PTR,) * 7),
    "dds_qget_deadline": (_BOOL, (_PTR, _PTR)),
    "dds_qget_lifespan": (_BOOL, (_PTR, _PTR)),
    "dds_qget_liveliness": (_BOOL, (_PTR, _PTR, _PTR)),
    "dds_qget_userdata": (_BOOL, (_PTR, _PTR, _PTR)),
    "dds_free": (None, (_PTR,)),
    "dds_strretcode": (_STR, (_I32,)),
}


@cache
def library() -> Any:
    """Return the loaded library with its signatures set."""
    from cyclonedds.internal import load_cyclonedds

    lib = load_cyclonedds()
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(lib, name)
        function.restype = result
        function.argtypes = arguments
    return lib


def error_text(code: int) -> str:
    """Return the text of Cyclone DDS for one of its return codes."""
    text: bytes = library().dds_strretcode(code)
    return text.decode()


def entity_guid(entity: int) -> bytes:
    """Return the 16-byte GUID of a DDS entity."""
    guid = (ct.c_uint8 * 16)()
    library().dds_get_guid(entity, ct.byref(guid))
    return bytes(guid)


# --- QoS objects ----------------------------------------------------------------------------------------------

_RELIABILITY = (Reliability.BEST_EFFORT, Reliability.RELIABLE)
_HISTORY = (History.KEEP_LAST, History.KEEP_ALL)
# MANUAL_BY_PARTICIPANT of DDS lies in between and does not exist in ROS 2; it is treated as AUTOMATIC.
_LIVELINESS = (Liveliness.AUTOMATIC, Liveliness.AUTOMATIC, Liveliness.MANUAL_BY_TOPIC)
_DURABILITY = (Durability.VOLATILE, Durability.TRANSIENT_LOCAL)
_UNLIMITED = -1
_IGNORE_PARTICIPANT = 1  # enum dds_ignorelocal_kind
# Longest time for which a KEEP_ALL writer blocks on unacknowledged samples, ns: Cyclone's default.
_MAX_BLOCKING_NS = 100_000_000


@contextmanager
def qos_object(user_data: bytes) -> Iterator[int]:
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
    """Options of a reader or writer beside its QoS profile."""

    user_data: bytes  #: USER_DATA of the endpoint.
    partition: str  #: PARTITION of the endpoint.
    ignore_local: bool  #: Whether it never matches endpoints of its own participant.
    #: Largest number of samples that a KEEP_ALL reader holds; beyond it senders wait.
    max_samples: int
    unacknowledged: int  #: Least number of samples kept until acknowledgement, late joiners or not.
    batching: bool  #: Whether a writer sends only when it is flushed or a packet is full.
    max_blocking_ns: int  #: Longest time for which a KEEP_ALL writer blocks, ns.


@contextmanager
def endpoint_qos(profile: QoSProfile, **more: Unpack[EndpointOptions]) -> Iterator[int]:
    """Yield the C QoS object of a reader or writer with a profile of ROS 2."""
    lib = library()
    history = _HISTORY.index(profile.history)
    depth = profile.depth if profile.history is History.KEEP_LAST else _UNLIMITED
    with qos_object(more.get("user_data", b"")) as qos:
        max_blocking_ns = more.get("max_blocking_ns", _MAX_BLOCKING_NS)
        lib.dds_qset_reliability(qos, _RELIABILITY.index(profile.reliability), max_blocking_ns)
        lib.dds_qset_durability(qos, _DURABILITY.index(profile.durability))
        kept = depth if depth == _UNLIMITED else max(depth, more.get("unacknowledged", 0))
        lib.dds_qset_history(qos, history, kept)
        # DDS has a separate policy for the samples of late joiners; ROS 2 ties it to the history.
        lib.dds_qset_durability_service(qos, 0, history, depth, _UNLIMITED, _UNLIMITED, _UNLIMITED)
        lib.dds_qset_deadline(qos, _or_infinite(profile.deadline_ns))
        lib.dds_qset_lifespan(qos, _or_infinite(profile.lifespan_ns))
        lib.dds_qset_liveliness(
            qos, _LIVELINESS.index(profile.liveliness), _or_infinite(profile.lease_ns)
        )
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
    """Return the QoS profile of a discovered endpoint; missing policies have DDS's defaults."""
    lib = library()
    reliability, durability, history, depth = ct.c_int(), ct.c_int(), ct.c_int(), ct.c_int32(1)
    blocking, deadline, lifespan = ct.c_int64(), ct.c_int64(INFINITY_NS), ct.c_int64(INFINITY_NS)
    lib.dds_qget_reliability(qos, ct.byref(reliability), ct.byref(blocking))
    lib.dds_qget_durability(qos, ct.byref(durability))
    lib.dds_qget_history(qos, ct.byref(history), ct.byref(depth))
    if durability.value:  # with TRANSIENT_LOCAL the history of late joiners counts
        rest = [ct.byref(ct.c_int64()), *(ct.byref(ct.c_int32()) for _ in range(3))]
        lib.dds_qget_durability_service(qos, rest[0], ct.byref(history), ct.byref(depth), *rest[1:])
    lib.dds_qget_deadline(qos, ct.byref(deadline))
    lib.dds_qget_lifespan(qos, ct.byref(lifespan))
    liveliness, lease = ct.c_int(), ct.c_int64(INFINITY_NS)
    lib.dds_qget_liveliness(qos, ct.byref(liveliness), ct.byref(lease))
    return QoSProfile(
        reliability=_RELIABILITY[reliability.value],
        # DDS has TRANSIENT and PERSISTENT above TRANSIENT_LOCAL; ROS 2 has neither.
        durability=_DURABILITY[min(durability.value, 1)],
        history=_HISTORY[history.value],
        depth=max(depth.value, 1),
        deadline_ns=_or_none(deadline.value),
        lifespan_ns=_or_none(lifespan.value),
        liveliness=_LIVELINESS[liveliness.value],
        lease_ns=_or_none(lease.value),
    )


def user_data(qos: int) -> bytes:
    """Return the USER_DATA of a QoS object, given by its address; empty if there is none."""
    lib = library()
    value, size = ct.c_void_p(), ct.c_size_t()
    if not lib.dds_qget_userdata(qos, ct.byref(value), ct.byref(size)) or not value.value:
        return b""
    try:
        return ct.string_at(value.value, size.value)
    finally:
        lib.dds_free(value)


def _or_infinite(duration_ns: int | None) -> int:
    return INFINITY_NS if duration_ns is None else duration_ns


def _or_none(duration_ns: int) -> int | None:
    return None if duration_ns >= INFINITY_NS or duration_ns <= 0 else duration_ns
