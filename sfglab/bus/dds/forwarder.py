"""Forwarding inside Cyclone DDS: samples pass from reader to writer without a copy into Python.

A sample keeps its source time stamp from `dds_takecdr` to `dds_forwardcdr`. Only the thread that reads for the
source node touches samples, and the loop gives it orders. There is therefore nothing to lock, and a writer that
blocks never blocks the loop. Samples of less than a packet wait for `flush`. Only a transform copies a sample's
bytes into Python.
"""

from __future__ import annotations

import ctypes as ct
import logging
import re
from collections import deque
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.backend import Backend, LoopForward, LoopWriter
from sfglab.bus.dds import clib
from sfglab.bus.dds.clib import ANY_STATE, RETCODE_ERROR, RETCODE_TIMEOUT, error_text, library
from sfglab.bus.dds.endpoints import (
    UNKNOWN_GID,
    Publishers,
    bytes_from_serdata,
    delete_writer,
    has_all_acknowledged,
    idl_type,
    serdata_from_bytes,
    sertype_of,
    source_timestamp_ns,
    stamp,
)
from sfglab.bus.forwarding import Forward, GuardedWriter, Transform
from sfglab.messages import UnknownTypeError, definition
from sfglab.qos import Durability, History

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.dds.domain import DdsParticipant, WaitSetThread
    from sfglab.qos import QoSProfile

_log = logging.getLogger("sfglab.bus")

MAX_BLOCKING_NS = 5_000_000
"""Longest time for which a KEEP_ALL writer blocks on slow readers, ns; meanwhile no other topic is served."""
# Measured with 64-byte samples at full speed: sent together, they cost the router a third less system time.
_PACKET_BYTES = 1024
_BATCH = 64
# Largest number of samples that a KEEP_ALL reader holds before its senders have to wait. Without it, a target
# slower than its source would fill the memory. Measured: 256 halve the rate of 64-byte messages, and more than
# 1024 gain nothing. At full speed 1024 images of 691 kB took 900 MB, and 250 ms to pass.
_MAX_KEPT = 1024
_MAX_KEPT_BLOBS = 96  # 66 MB of such images; for types with arrays of bytes, and for unknown types
_BLOB = re.compile(r"^(?:byte|char|u?int8)\[(?:<=\d+)?\]", re.MULTILINE)
# A TRANSIENT_LOCAL history is forwarded at once, and Fast DDS does not announce its depth. Present readers
# receive all of it.
_UNACKNOWLEDGED = 256
_PART = re.compile("_(?:SendGoal_|GetResult_)?(?:Request|Response)$|_FeedbackMessage$")


def wire_type(endpoint: RawEndpoint) -> type[Any]:
    """Return Cyclone's type of a topic's samples; for an unknown type, which is logged once, an opaque type."""
    try:
        return idl_type(endpoint)
    except UnknownTypeError:
        return _opaque(endpoint.type)


@cache
def _opaque(type_: str) -> type[Any]:
    """Return a type that accepts any sample."""
    from sfglab.messages.dds import opaque_idl_struct

    _warn_of(_PART.sub("", type_))
    return opaque_idl_struct(type_)


@cache
def _warn_of(interface: str) -> None:
    """Log an unknown type once, also for a service or an action, which have many types."""
    _log.warning(
        "forwarding: type %s is not known here; its samples pass as they are between ROS 2 nodes, but not to "
        "and from nodes of sfglab that know the type: give its package with --interfaces",
        interface,
    )


def _max_kept(type_: str) -> int:
    """Return how many samples of a type a KEEP_ALL reader may hold, because Cyclone DDS counts no bytes."""
    try:
        return _MAX_KEPT_BLOBS if _BLOB.search(definition(type_)) else _MAX_KEPT
    except UnknownTypeError:
        return _MAX_KEPT_BLOBS


class DdsRawWriter(GuardedWriter):
    """Raw writer in the target domain, which lives in the forwarder's thread.

    Its C writer batches. A KEEP_ALL writer may block because it must not lose unacknowledged samples.
    """

    def __init__(
        self,
        create: Callable[[QoSProfile], int],
        order: Callable[[Callable[[], None]], None],
        qos: QoSProfile,
    ) -> None:
        super().__init__(qos)
        self._create_handle = create
        self._create(qos)
        self.gid = clib.entity_guid(self._handle)  #: 16-byte GUID of the writer.
        self._order = order
        self._keeps_all = qos.history is History.KEEP_ALL
        self._unsent = False
        self._failed = False

    def close(self) -> None:
        """Delete the writer once every order given so far is carried out; repeated calls are harmless."""
        self._order(self._end)

    def _create(self, qos: QoSProfile) -> None:
        self._handle = self._create_handle(qos)
        self.sertype = sertype_of(self._handle)  #: Cyclone's type of new samples.

    def _delete(self) -> None:
        self.flush()
        delete_writer(self._handle)
        self._handle = 0

    def _has_all_acknowledged(self) -> bool:
        return has_all_acknowledged(self._handle)

    def hand_on(self, serdata: int, size: int) -> int:
        """Send a sample, whose CDR has `size` bytes, with the next packet or at once.

        Returns:
            0 if the sample was sent. `RETCODE_TIMEOUT` if slow readers have to catch up first; the sample
            then still belongs to the caller. Another negative code if the sample is lost.
        """
        lib = library()
        self.show_life(alive=True)
        self.bound_backlog(size)
        if self._keeps_all:
            lib.ddsi_serdata_ref(serdata)
        code: int = lib.dds_forwardcdr(
            self._handle, serdata
        )  # consumes a reference, also on failure
        if self._keeps_all and code != RETCODE_TIMEOUT:
            lib.ddsi_serdata_unref(serdata)
        if code < 0:
            return self._refused(code)
        self._unsent = True
        if size >= _PACKET_BYTES:
            self.flush()
        return 0

    def flush(self) -> None:
        """Send the samples that wait for a full packet."""
        if self._unsent:
            self._unsent = False
            library().dds_write_flush(self._handle)

    def _end(self) -> None:
        if not self.closed:
            self.closed = True
            if self._handle:
                self._delete()

    def _refused(self, code: int) -> int:
        if self._keeps_all and code == RETCODE_TIMEOUT:
            return code
        if not self._failed:
            self._failed = True
            _log.warning(
                "forwarding: a sample was not sent on (%s); more are only counted", error_text(code)
            )
        return RETCODE_ERROR


class DdsForwarder:
    """Forwarder from one live node to another; made by `Node.open_forwarder`. Services pass on the loop."""

    def __init__(
        self, source: DdsParticipant, target: DdsParticipant, both: tuple[Backend, Backend]
    ) -> None:
        self._source = source
        self._target = target
        self._backends = both
        self._forwards: set[DdsForward] = set()
        self._batch = cache(_Batch)

    def open(self, endpoint: RawEndpoint) -> DdsForward | LoopForward:
        """Read a topic in the source domain; samples of a source are held until it is admitted or refused."""
        if endpoint.is_service:
            return LoopForward(self._backends[0], replace(endpoint, forwards=True))
        most = _max_kept(endpoint.type) if endpoint.qos.history is History.KEEP_ALL else 0
        handle = self._source.create_reader(
            endpoint.dds_topic,
            wire_type(endpoint),
            endpoint.qos,
            user_data=endpoint.user_data,
            ignore_local=True,
            max_samples=most,
        )
        forward = DdsForward(
            handle,
            self._batch(
                most // 16 or _BATCH
            ),  # taken samples wait in addition to those that the reader holds
            waitset=self._source.waitset,
            on_closed=self._forwards.discard,
        )
        self._forwards.add(forward)
        return forward

    def open_writer(self, endpoint: RawEndpoint) -> DdsRawWriter | LoopWriter:
        """Write to a topic in the target domain."""
        if endpoint.is_service:
            return LoopWriter(self._backends[1], replace(endpoint, forwards=True))
        create = partial(
            self._target.create_writer,
            endpoint.dds_topic,
            wire_type(endpoint),
            user_data=endpoint.user_data,
            ignore_local=True,
            batching=True,
            unacknowledged=_UNACKNOWLEDGED
            if endpoint.qos.durability is Durability.TRANSIENT_LOCAL
            else 0,
            max_blocking_ns=MAX_BLOCKING_NS,
        )
        return DdsRawWriter(create, self._source.waitset.post, endpoint.qos)

    def close(self) -> None:
        """Close all forwards; to be called after the source node has stopped reading."""
        self._source.waitset.run_posted()
        for forward in tuple(self._forwards):
            forward.close()
        self._source.waitset.run_posted()


class _Batch:
    """Buffers for taken samples, shared because one thread reads all readers of a forwarder in turn."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.serdata: Any = (ct.c_void_p * size)()
        self.infos: Any = (clib.SampleInfo * size)()
        self.each_info = list(self.infos)  # made once because they are views of the same memory


class DdsForward(Forward[int, DdsRawWriter]):
    """Forward whose samples pass in a WaitSet thread, as references to Cyclone's samples."""

    def __init__(
        self,
        handle: int,
        batch: _Batch,
        *,
        waitset: WaitSetThread,
        on_closed: Callable[[DdsForward], None],
    ) -> None:
        super().__init__()
        self._handle = handle
        self._batch = batch
        self._waitset = waitset
        self._on_closed = on_closed
        self._open = True
        self._unflushed: set[DdsRawWriter] = set()
        self._waiting: deque[tuple[DdsRawWriter, int]] = deque()
        self._publishers = Publishers(handle)
        library().dds_set_status_mask(
            handle, clib.STATUS_SUBSCRIPTION_MATCHED | clib.STATUS_LIVELINESS_CHANGED
        )
        waitset.attach(handle, self._note_publishers)
        self._condition = waitset.attach_reader(handle, self._take)

    def close(self) -> None:
        """Close the forward at once; repeated calls are harmless."""
        if self._open:
            self._open = False
            self._order(self._end)

    def _order(self, order: Callable[[], None]) -> None:
        self._waitset.post(partial(self._carry_out, order))

    def _carry_out(self, order: Callable[[], None]) -> None:
        order()
        self._flush()

    def _end(self) -> None:
        self._waitset.detach(self._condition)
        self._waitset.detach(self._handle)
        library().dds_delete(self._handle)
        self._gate.close()
        while self._waiting:
            self._drop(self._waiting.popleft()[1])
        self._on_closed(self)

    def _take(self) -> None:
        if self._waiting:
            return  # the reader keeps the rest until `_resume` has finished, and its senders wait
        lib, batch = library(), self._batch
        count = lib.dds_takecdr(self._handle, batch.serdata, batch.size, batch.infos, ANY_STATE)
        for i in range(count):
            serdata, info = batch.serdata[i], batch.each_info[i]
            if not info.valid_data:
                lib.ddsi_serdata_unref(serdata)
                continue
            source = self._publishers.gid(info.publication_handle)
            if source == UNKNOWN_GID or not self._open:
                self._drop(serdata)
            else:
                self._gate.take(source, serdata)
        self._flush()

    def _flush(self) -> None:
        """Send the samples that were handed on; samples that were taken together are sent together."""
        for writer in self._unflushed:
            writer.flush()
        self._unflushed.clear()

    def _send(self, destination: tuple[DdsRawWriter, Transform | None], serdata: int) -> None:
        writer, transform = destination
        changed = serdata if transform is None else _transformed(serdata, transform, writer.sertype)
        if changed is None:
            self._drop(serdata)
        elif self._waiting or not self._handed_on(writer, changed):
            self._waiting.append((writer, changed))
            if len(self._waiting) == 1:
                self._order(self._resume)

    def _handed_on(self, writer: DdsRawWriter, serdata: int) -> bool:
        """Hand a sample to a raw writer; return False if the sample has to wait."""
        size = library().ddsi_serdata_size(serdata)
        code = writer.hand_on(serdata, size)
        if code == RETCODE_TIMEOUT:
            return False
        self._unflushed.add(writer)
        if code < 0:
            self.counts.dropped += 1
        else:
            self.counts.forwarded += 1
            self.counts.bytes += size
        return True

    def _resume(self) -> None:
        """Try again to send waiting samples; other work of the thread runs between two tries."""
        while self._waiting:
            writer, serdata = self._waiting[0]
            if writer.closed:
                self._drop(serdata)
            elif not self._handed_on(writer, serdata):
                self._order(self._resume)
                break
            self._waiting.popleft()
        self._flush()

    def _drop(self, serdata: int) -> None:
        library().ddsi_serdata_unref(serdata)
        self.counts.dropped += 1

    def _note_publishers(self) -> None:
        library().dds_get_subscription_matched_status(self._handle, ct.byref(clib.MatchedStatus()))
        self._publishers.matched()
        # The writer of a publisher that Cyclone does not name is removed with its participant.
        change = self._publishers.changed_life()
        destination = None if change is None else self._gate.destination_of(change[0])
        if change is not None and destination is not None:
            destination[0].show_life(alive=change[1])


def _transformed(serdata: int, transform: Transform, sertype: int | None) -> int | None:
    """Return the changed sample, or the same one if nothing changed; None if it is dropped."""
    cdr = bytes_from_serdata(serdata)
    try:
        result = transform(cdr)
    except Exception:  # noqa: BLE001 - logged; one bad sample must not stop the others of its batch
        _log.exception("forwarding: a sample could not be transformed")
        return None
    if result is cdr:
        return serdata
    changed = None if result is None else serdata_from_bytes(sertype, result)
    if changed is None:
        return None
    stamp(changed, source_timestamp_ns(serdata))
    library().ddsi_serdata_unref(serdata)
    return changed
