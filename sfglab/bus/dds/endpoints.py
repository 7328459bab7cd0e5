"""Raw DDS writer and reader of one topic: CDR in, CDR out, with one copy of a sample's bytes in each direction.

Every C call here releases the interpreter lock.
"""

from __future__ import annotations

import ctypes as ct
import time
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.dds import clib
from sfglab.bus.dds.clib import (
    ANY_STATE,
    SDK_DATA,
    TIMESTAMP_INVALID,
    TIMESTAMP_OFFSET,
    IoVec,
    library,
)
from sfglab.bus.errors import PublishError, WriterBlockedError, not_cdr_error
from sfglab.messages import serialize

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.dds.domain import WaitSetThread
    from sfglab.bus.endpoints import Sample

CDR_HEADER_BYTES = 4
_PADDING = ct.create_string_buffer(4)
_PADDING_ADDRESS = ct.addressof(_PADDING)

_BATCH = 64
_MAX_MATCHED = 4096
_MAX_LEFT = 256  # Number of publishers that a reader remembers after they have left.
UNKNOWN_GID = bytes(16)  #: GID of an endpoint that left before its GUID was read.


def _matched(list_of: Callable[..., int], endpoint: int) -> list[int]:
    """Return the handles of matching endpoints, at most `_MAX_MATCHED`; Cyclone's count includes all."""
    found = (ct.c_uint64 * _MAX_MATCHED)()
    count = list_of(endpoint, ct.byref(found), _MAX_MATCHED)
    return found[: max(count, 0)]


def idl_type(endpoint: RawEndpoint) -> type[Any]:
    """Return the Cyclone DDS type of a topic's samples.

    Raises:
        UnknownTypeError: There is no definition of the type.
    """
    from sfglab.messages.dds import idl_struct, service_half_idl_struct

    return (
        service_half_idl_struct(endpoint.type) if endpoint.is_service else idl_struct(endpoint.type)
    )


def sertype_of(entity: int) -> int | None:
    """Return Cyclone's sertype of a writer, with which its samples are made."""
    sertype = ct.c_void_p()
    library().dds_get_entity_sertype(entity, ct.byref(sertype))
    return sertype.value


def serdata_from_bytes(sertype: int | None, data: Any) -> int | None:
    """Return a new, unstamped sample from `bytes` or a contiguous array; None if they do not parse."""
    size = len(data)
    if size < CDR_HEADER_BYTES:
        return None
    # RTPS sends whole words, so Cyclone may read up to three bytes beyond the end.
    padding = -size % 4
    address = (
        ct.cast(ct.c_char_p(data), ct.c_void_p).value
        if isinstance(data, bytes)
        else data.ctypes.data
    )
    parts = (IoVec * 2)(IoVec(address, size), IoVec(_PADDING_ADDRESS, padding))
    serdata: int | None = library().ddsi_serdata_from_ser_iov(
        sertype, SDK_DATA, 2 if padding else 1, ct.byref(parts), size + padding
    )
    return serdata


def bytes_from_serdata(serdata: int) -> bytes:
    """Return a copy of a sample's CDR with its header; the caller keeps its reference."""
    lib = library()
    part = IoVec()
    size = lib.ddsi_serdata_size(serdata)
    reference = lib.ddsi_serdata_to_ser_ref(serdata, 0, size, ct.byref(part))
    try:
        return ct.string_at(part.base, size)
    finally:
        lib.ddsi_serdata_to_ser_unref(reference, ct.byref(part))


def source_timestamp_ns(serdata: int) -> int:
    """Return the source time stamp of a sample, by its publisher's clock, Unix time, ns."""
    return ct.c_int64.from_address(serdata + TIMESTAMP_OFFSET).value


def stamp(serdata: int, source_timestamp_ns: int) -> None:
    """Set the source time stamp of a new sample, Unix time, ns."""
    field = ct.c_int64.from_address(serdata + TIMESTAMP_OFFSET)
    assert field.value == TIMESTAMP_INVALID, "this Cyclone DDS has another serdata layout"
    field.value = source_timestamp_ns


def has_all_acknowledged(writer: int) -> bool:
    """Return whether all reliable readers have acknowledged all samples of a writer."""
    code: int = library().dds_wait_for_acks(writer, 0)
    return code >= 0


def delete_writer(handle: int) -> None:
    """Delete a writer without waiting for missing acknowledgements."""
    if has_all_acknowledged(handle):
        library().dds_delete(handle)
        return
    # Cyclone waits another second for such readers (WriterLingerDuration), which would block the caller's loop.
    # A killed process stays matched until its lease expires.
    Thread(target=library().dds_delete, args=(handle,), daemon=True).start()


_READER_STATUS = clib.STATUS_SUBSCRIPTION_MATCHED | clib.STATUS_SAMPLE_LOST


class DdsWriter:
    """Writer of CDR; `on_matched` is called in the WaitSet thread when the matching readers change."""

    def __init__(
        self,
        handle: int,
        topic: str,
        *,
        type_: str,
        waitset: WaitSetThread,
        on_matched: Callable[[], None],
    ) -> None:
        self.handle = handle
        self.gid = clib.entity_guid(handle)
        self.may_block = False  #: Whether the writer has KEEP_ALL and blocks on slow readers.
        self.matched = 0
        self.matched_prefixes: frozenset[bytes] = frozenset()
        self._topic = topic
        self._type = type_
        self._waitset = waitset
        self._on_matched = on_matched
        self._sertype = sertype_of(handle)
        library().dds_set_status_mask(handle, clib.STATUS_PUBLICATION_MATCHED)
        waitset.attach(handle, self._update_matched)

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send one serialized message with its source time stamp, Unix time, ns; None for the present time.

        Raises:
            InvalidMessageError: The CDR is no message of the topic's type.
            WriterBlockedError: The writer has KEEP_ALL and waits for slow readers.
            PublishError: The middleware refused the message.
        """
        data = cdr if isinstance(cdr, bytes) else np.frombuffer(cdr, np.uint8)
        serdata = serdata_from_bytes(self._sertype, data)
        if not serdata:
            size = len(data)
            reason = (
                "shorter than its header"
                if size < CDR_HEADER_BYTES
                else "Cyclone DDS cannot parse them"
            )
            raise not_cdr_error(self._topic, self._type, size_bytes=size, reason=reason)
        stamp(serdata, time.time_ns() if source_timestamp_ns is None else source_timestamp_ns)
        code = library().dds_forwardcdr(
            self.handle, serdata
        )  # consumes the reference, also on failure
        if code < 0:
            reason = clib.error_text(code)
            if code == clib.RETCODE_TIMEOUT:
                reason += (
                    ": slow reliable readers have not acknowledged; publish later or with KEEP_LAST"
                )
                raise WriterBlockedError(self._topic, code=code, reason=reason)
            raise PublishError(self._topic, code=code, reason=reason)

    def write_message(self, message: Any) -> None:
        """Serialize and send a message; see `write`."""
        self.write(serialize(message))

    def acknowledged(self) -> bool:
        """Return whether all reliable readers have acknowledged all samples."""
        return has_all_acknowledged(self.handle)

    def close(self) -> None:
        """Delete the writer without waiting for missing acknowledgements."""
        self._waitset.detach(self.handle)
        delete_writer(self.handle)

    def _update_matched(self) -> None:
        lib = library()
        status = clib.MatchedStatus()
        lib.dds_get_publication_matched_status(self.handle, ct.byref(status))
        readers = _matched(lib.dds_get_matched_subscriptions, self.handle)
        gids = (
            matched_gid(lib.dds_get_matched_subscription_data, self.handle, reader)
            for reader in readers
        )
        self.matched_prefixes = frozenset(gid[:12] for gid in gids)
        self.matched = status.current_count
        self._on_matched()


class Publishers:
    """GUIDs of a reader's matching publishers, by the handles that samples carry."""

    def __init__(self, reader: int) -> None:
        self._reader = reader
        self._gids: dict[int, bytes] = {}

    def gid(self, publication: int) -> bytes:
        """Return a publisher's GUID; zeros if the publisher left before its GUID was read."""
        gid = self._gids.get(publication)
        if gid is None:
            gid = matched_gid(library().dds_get_matched_publication_data, self._reader, publication)
            if gid != UNKNOWN_GID:
                self._gids[publication] = gid
        return gid

    def matched(self) -> list[bytes]:
        """Return the GUIDs of matching publishers, and remember them.

        A sample may be taken after its publisher has left, when Cyclone does not know the GUID any more.
        """
        publications = _matched(library().dds_get_matched_publications, self._reader)
        here = {publication: self.gid(publication) for publication in publications}
        left = [publication for publication in self._gids if publication not in here]
        for publication in left[:-_MAX_LEFT]:
            del self._gids[publication]
        return list(here.values())

    def changed_life(self) -> tuple[bytes, bool] | None:
        """Return the publisher whose liveliness changed and whether it is alive now; None if there is none.

        Of two at once Cyclone names only the latest.
        """
        life = clib.LivelinessStatus()
        library().dds_get_liveliness_changed_status(self._reader, ct.byref(life))
        is_alive = life.alive_count_change > 0
        if not life.last_handle or not (is_alive or life.not_alive_count_change > 0):
            return None
        return self.gid(life.last_handle), is_alive


class DdsReader:
    """Reader of CDR, in batches of at most `batch` samples; callbacks run in the WaitSet thread."""

    def __init__(
        self,
        handle: int,
        *,
        waitset: WaitSetThread,
        on_samples: Callable[[list[Sample]], None],
        on_matched: Callable[[], None],
        batch: int = _BATCH,
    ) -> None:
        self.handle = handle
        self.gid = clib.entity_guid(handle)
        self.matched = 0
        self.matched_prefixes: frozenset[bytes] = frozenset()
        self.lost = 0
        self._waitset = waitset
        self._on_samples = on_samples
        self._on_matched = on_matched
        self._on_life: Callable[[bytes, bool], None] | None = None
        self._publishers = Publishers(handle)
        self._batch = batch
        self._serdata: Any = (ct.c_void_p * batch)()
        self._infos: Any = (clib.SampleInfo * batch)()
        library().dds_set_status_mask(handle, _READER_STATUS)
        waitset.attach(handle, self._update_status)
        self._condition = waitset.attach_reader(handle, self._take)

    def watch_life(self, on_life: Callable[[bytes, bool], None]) -> None:
        """Call `on_life` in the WaitSet thread when a publisher becomes alive or loses its liveliness."""
        self._on_life = on_life
        library().dds_set_status_mask(self.handle, _READER_STATUS | clib.STATUS_LIVELINESS_CHANGED)

    def close(self) -> None:
        """Delete the reader."""
        self._waitset.detach(self._condition)
        self._waitset.detach(self.handle)
        library().dds_delete(self.handle)

    def _take(self) -> None:
        lib = library()
        count = lib.dds_takecdr(self.handle, self._serdata, self._batch, self._infos, ANY_STATE)
        now_ns = time.time_ns()
        samples: list[Sample] = []
        for i in range(count):
            serdata, info = self._serdata[i], self._infos[i]
            if info.valid_data:
                gid = self._publishers.gid(info.publication_handle)
                samples.append((bytes_from_serdata(serdata), info.source_timestamp, now_ns, gid))
            lib.ddsi_serdata_unref(serdata)
        if samples:
            self._on_samples(samples)

    def _update_status(self) -> None:
        lib = library()
        lost, matched = clib.SampleLostStatus(), clib.MatchedStatus()
        lib.dds_get_sample_lost_status(self.handle, ct.byref(lost))
        lib.dds_get_subscription_matched_status(self.handle, ct.byref(matched))
        if self._on_life is not None and (change := self._publishers.changed_life()) is not None:
            self._on_life(*change)
        self.matched_prefixes = frozenset(gid[:12] for gid in self._publishers.matched())
        self.lost = lost.total_count
        self.matched = matched.current_count
        self._on_matched()


class ShmAnnouncement:
    """DDS endpoint that shows a shared-memory endpoint in the graph, in a separate partition."""

    def __init__(self, handle: int) -> None:
        self.gid = clib.entity_guid(handle)  #: 16-byte GUID of the DDS endpoint.
        self._handle = handle

    def close(self) -> None:
        """Remove the endpoint from the graph."""
        library().dds_delete(self._handle)


def matched_gid(function: Any, entity: int, handle: int) -> bytes:
    """Return the GUID of a matching endpoint by its handle, with Cyclone's function; zeros if it has left."""
    endpoint = function(entity, handle)
    if not endpoint:
        return UNKNOWN_GID  # the endpoint left after its notification
    try:
        return bytes(endpoint.contents.key)
    finally:
        library().dds_builtintopic_free_endpoint(endpoint)
