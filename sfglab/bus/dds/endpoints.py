"""A raw DDS writer and a raw DDS reader of one topic: CDR in, CDR out.

Every C call here releases the interpreter lock. A sample's bytes are copied once on either way: into the
serdata that Cyclone sends, and out of the one it received.
"""

from __future__ import annotations

import ctypes as ct
import time
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.dds.clib import (
    ANY_STATE,
    RETCODE_TIMEOUT,
    STATUS_PUBLICATION_MATCHED,
    STATUS_SAMPLE_LOST,
    STATUS_SUBSCRIPTION_MATCHED,
    MatchedStatus,
    SampleInfo,
    SampleLostStatus,
    error_text,
    library,
)
from sfglab.bus.dds.samples import (
    CDR_HEADER_BYTES,
    bytes_from_serdata,
    serdata_from_bytes,
    sertype_of,
    stamp,
)
from sfglab.bus.errors import InvalidMessageError, PublishError

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.dds.waiter import Waiter
    from sfglab.bus.queue import Sample


_BATCH = 64
_MAX_MATCHED = 4096
UNKNOWN_GID = bytes(16)
"""Stands for an endpoint that was gone before anybody could look."""


def entity_guid(entity: int) -> bytes:
    """Return the 16-byte GUID of a DDS entity."""
    guid = (ct.c_uint8 * 16)()
    library().dds_get_guid(entity, ct.byref(guid))
    return bytes(guid)


def delete_writer(handle: int) -> None:
    """Delete a writer, without waiting for readers that have not acknowledged everything."""
    if library().dds_wait_for_acks(handle, 0) >= 0:
        library().dds_delete(handle)
        return
    # Cyclone gives such readers another second (WriterLingerDuration), in which the caller's loop would
    # stand still: a process that was killed stays matched until its lease runs out.
    Thread(target=library().dds_delete, args=(handle,), daemon=True).start()


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
        self._sertype = sertype_of(handle)
        library().dds_set_status_mask(handle, STATUS_PUBLICATION_MATCHED)
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
        serdata = serdata_from_bytes(self._sertype, data)
        if not serdata:
            size = len(data)
            reason = "shorter than its header" if size < CDR_HEADER_BYTES else "Cyclone DDS cannot parse them"
            raise InvalidMessageError(self._topic, self._type, size_bytes=size, reason=reason)
        stamp(serdata, time.time_ns() if source_timestamp_ns is None else source_timestamp_ns)
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
        """Delete the writer, without waiting for readers that have not acknowledged everything."""
        self._waiter.detach(self.handle)
        delete_writer(self.handle)

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
            matched_gid(lib.dds_get_matched_subscription_data, self.handle, handles[i]) for i in range(count)
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
                gid = self._gid(info.publication_handle)
                samples.append((bytes_from_serdata(serdata), info.source_timestamp, now_ns, gid))
            lib.ddsi_serdata_unref(serdata)
        if samples:
            self._on_samples(samples)

    def _gid(self, publication: int) -> bytes:
        gid = self._gids.get(publication)
        if gid is None:
            gid = matched_gid(library().dds_get_matched_publication_data, self.handle, publication)
            if gid != UNKNOWN_GID:
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


def matched_gid(function: Any, entity: int, handle: int) -> bytes:
    """Return the GUID of a matching endpoint, zeros when it has gone.

    Args:
        function: `dds_get_matched_publication_data` or `dds_get_matched_subscription_data`.
        entity: The reader or writer.
        handle: The instance handle of what matches it.
    """
    endpoint = function(entity, handle)
    if not endpoint:
        return UNKNOWN_GID  # it left between the notice and the look
    try:
        return bytes(endpoint.contents.key)
    finally:
        library().dds_builtintopic_free_endpoint(endpoint)
