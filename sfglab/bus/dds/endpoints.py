"""A raw DDS writer and a raw DDS reader of one topic: CDR in, CDR out.

Every C call here releases the interpreter lock. A sample's bytes are copied once on either way: into the
serdata that Cyclone sends, and out of the one it received.
"""

from __future__ import annotations

import ctypes as ct
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.dds.clib import (
    ANY_STATE,
    RETCODE_TIMEOUT,
    SDK_DATA,
    STATUS_PUBLICATION_MATCHED,
    STATUS_SAMPLE_LOST,
    STATUS_SUBSCRIPTION_MATCHED,
    TIMESTAMP_INVALID,
    TIMESTAMP_OFFSET,
    IoVec,
    MatchedStatus,
    SampleInfo,
    SampleLostStatus,
    error_text,
    library,
)
from sfglab.bus.errors import InvalidMessageError, PublishError

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.dds.waiter import Waiter
    from sfglab.bus.queue import Sample

__all__ = ["RawReader", "RawWriter", "entity_guid"]

_BATCH = 64
_MAX_MATCHED = 4096
_UNKNOWN_GID = bytes(16)
_PADDING = ct.create_string_buffer(4)
_PADDING_ADDRESS = ct.addressof(_PADDING)
_CDR_HEADER_BYTES = 4


def entity_guid(entity: int) -> bytes:
    """Return the 16-byte GUID of a DDS entity."""
    guid = (ct.c_uint8 * 16)()
    library().dds_get_guid(entity, ct.byref(guid))
    return bytes(guid)


class RawWriter:
    """Writes CDR to a topic.

    Args:
        handle: The C handle of the writer.
        topic: The ROS topic, for error messages.
        type_: The ROS type, for error messages.
        waiter: Waits for changes of the matching readers.
        on_matched: Called, in the waiter's thread, after such a change.
    """

    def __init__(
        self, handle: int, topic: str, *, type_: str, waiter: Waiter, on_matched: Callable[[], None]
    ) -> None:
        self.handle = handle
        self.gid = entity_guid(handle)
        self.matched = 0
        self.matched_prefixes: frozenset[bytes] = frozenset()
        self._topic = topic
        self._type = type_
        self._waiter = waiter
        self._on_matched = on_matched
        sertype = ct.c_void_p()
        lib = library()
        lib.dds_get_entity_sertype(handle, ct.byref(sertype))
        self._sertype = sertype.value
        lib.dds_set_status_mask(handle, STATUS_PUBLICATION_MATCHED)
        waiter.attach(handle, self._update_matched)

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send one serialized message.

        Args:
            cdr: The message with its 4-byte header; any contiguous buffer.
            source_timestamp_ns: Unix time in nanoseconds; None is now.

        Raises:
            InvalidMessageError: The bytes are no message of the topic's type.
            PublishError: Cyclone could not send.
        """
        data = cdr if isinstance(cdr, bytes) else np.frombuffer(cdr, np.uint8)
        size = len(data)
        serdata = self._serdata(data, size) if size >= _CDR_HEADER_BYTES else None
        if not serdata:
            reason = "shorter than its header" if size < _CDR_HEADER_BYTES else "Cyclone DDS cannot parse them"
            raise InvalidMessageError(self._topic, self._type, size_bytes=size, reason=reason)
        stamp = ct.c_int64.from_address(serdata + TIMESTAMP_OFFSET)
        assert stamp.value == TIMESTAMP_INVALID, "this Cyclone DDS has another serdata layout"
        stamp.value = time.time_ns() if source_timestamp_ns is None else source_timestamp_ns
        code = library().dds_forwardcdr(self.handle, serdata)  # consumes the reference, also on failure
        if code < 0:
            self._raise(code)

    def wait_for_acks(self, timeout_s: float) -> bool:
        """Block until every reliable reader has acknowledged everything; False when that takes longer."""
        code: int = library().dds_wait_for_acks(self.handle, round(timeout_s * 1e9))
        if code < 0 and code != RETCODE_TIMEOUT:
            self._raise(code)
        return code >= 0

    def close(self) -> None:
        """Delete the writer."""
        self._waiter.detach(self.handle)
        library().dds_delete(self.handle)

    def _serdata(self, data: Any, size: int) -> int | None:
        # RTPS sends whole words, so Cyclone may read up to three bytes beyond the end.
        padding = -size % 4
        address = ct.cast(ct.c_char_p(data), ct.c_void_p).value if isinstance(data, bytes) else data.ctypes.data
        parts = (IoVec * 2)(IoVec(address, size), IoVec(_PADDING_ADDRESS, padding))
        serdata: int | None = library().ddsi_serdata_from_ser_iov(
            self._sertype, SDK_DATA, 2 if padding else 1, ct.byref(parts), size + padding
        )
        return serdata

    def _raise(self, code: int) -> None:
        reason = error_text(code)
        if code == RETCODE_TIMEOUT:
            reason += ": a KEEP_ALL writer waits for acknowledgements of slow reliable readers"
        raise PublishError(self._topic, code=code, reason=reason)

    def _update_matched(self) -> None:
        lib = library()
        status = MatchedStatus()
        lib.dds_get_publication_matched_status(self.handle, ct.byref(status))
        handles = (ct.c_uint64 * _MAX_MATCHED)()
        count = lib.dds_get_matched_subscriptions(self.handle, ct.byref(handles), _MAX_MATCHED)
        gids = (
            _matched_gid(lib.dds_get_matched_subscription_data, self.handle, handles[i]) for i in range(count)
        )
        self.matched_prefixes = frozenset(gid[:12] for gid in gids)
        self.matched = status.current_count
        self._on_matched()


class RawReader:
    """Takes CDR from a topic as it arrives.

    Args:
        handle: The C handle of the reader.
        waiter: Waits for samples and for changes of the matching writers.
        on_samples: Called with what arrived, in the waiter's thread.
        on_matched: Called, in the waiter's thread, after the matching writers changed.
    """

    def __init__(
        self,
        handle: int,
        *,
        waiter: Waiter,
        on_samples: Callable[[list[Sample]], None],
        on_matched: Callable[[], None],
    ) -> None:
        self.handle = handle
        self.gid = entity_guid(handle)
        self.matched = 0
        self.matched_prefixes: frozenset[bytes] = frozenset()
        self.lost = 0
        self._waiter = waiter
        self._on_samples = on_samples
        self._on_matched = on_matched
        self._gids: dict[int, bytes] = {}
        self._serdata: Any = (ct.c_void_p * _BATCH)()
        self._infos: Any = (SampleInfo * _BATCH)()
        library().dds_set_status_mask(handle, STATUS_SUBSCRIPTION_MATCHED | STATUS_SAMPLE_LOST)
        waiter.attach(handle, self._update_status)
        self._condition = waiter.attach_reader(handle, self._take)

    def close(self) -> None:
        """Delete the reader."""
        self._waiter.detach(self._condition)
        self._waiter.detach(self.handle)
        library().dds_delete(self.handle)

    def _take(self) -> None:
        lib = library()
        count = lib.dds_takecdr(self.handle, self._serdata, _BATCH, self._infos, ANY_STATE)
        now_ns = time.time_ns()
        samples: list[Sample] = []
        for i in range(count):
            serdata, info = self._serdata[i], self._infos[i]
            if info.valid_data:
                samples.append(
                    (_bytes_of(serdata), info.source_timestamp, now_ns, self._gid(info.publication_handle))
                )
            lib.ddsi_serdata_unref(serdata)
        if samples:
            self._on_samples(samples)

    def _gid(self, publication: int) -> bytes:
        gid = self._gids.get(publication)
        if gid is None:
            gid = _matched_gid(library().dds_get_matched_publication_data, self.handle, publication)
            if gid != _UNKNOWN_GID:
                self._gids[publication] = gid
        return gid

    def _update_status(self) -> None:
        lib = library()
        lost, matched = SampleLostStatus(), MatchedStatus()
        lib.dds_get_sample_lost_status(self.handle, ct.byref(lost))
        lib.dds_get_subscription_matched_status(self.handle, ct.byref(matched))
        handles = (ct.c_uint64 * _MAX_MATCHED)()
        count = max(lib.dds_get_matched_publications(self.handle, ct.byref(handles), _MAX_MATCHED), 0)
        alive = set(handles[:count])
        self._gids = {publication: gid for publication, gid in self._gids.items() if publication in alive}
        self.matched_prefixes = frozenset(self._gid(handles[i])[:12] for i in range(count))
        self.lost = lost.total_count
        self.matched = matched.current_count
        self._on_matched()


def _bytes_of(serdata: int) -> bytes:
    lib = library()
    part = IoVec()
    size = lib.ddsi_serdata_size(serdata)
    reference = lib.ddsi_serdata_to_ser_ref(serdata, 0, size, ct.byref(part))
    try:
        return ct.string_at(part.base, size)
    finally:
        lib.ddsi_serdata_to_ser_unref(reference, ct.byref(part))


def _matched_gid(function: Any, entity: int, handle: int) -> bytes:
    endpoint = function(entity, handle)
    if not endpoint:
        return _UNKNOWN_GID  # it left between the notice and the look
    try:
        return bytes(endpoint.contents.key)
    finally:
        library().dds_builtintopic_free_endpoint(endpoint)
