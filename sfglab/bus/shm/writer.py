"""Shared-memory publisher: its memory file, its socket, and the connections of its subscribers."""

from __future__ import annotations

import logging
import select
import time
from contextlib import contextmanager
from functools import partial
from socket import send_fds, socket
from typing import TYPE_CHECKING, Any

from sfglab.bus.errors import PublishError, check_size
from sfglab.bus.shm import wire
from sfglab.bus.shm.fanout import Fanout, SlotPool, slot_capacity
from sfglab.bus.shm.wire import (
    RETURN_BYTES,
    Announcement,
    ProtocolError,
    pack_announcement,
    unpack_returns,
)
from sfglab.messages import serialize_into, serialized_size
from sfglab.qos import Durability, History, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.endpoints import GraphEntry
    from sfglab.bus.loop import LoopBridge

_log = logging.getLogger(__name__)

#: Number of the largest messages for which a memory file has room; memory is allocated as it is used.
ARENA_MESSAGES = 64

_ENOSPC = 28
_NONE_LEFT = (23, 24)  # ENFILE, EMFILE: no descriptor is left
_AGAIN_S = 0.2
HELLO_S = 5.0  #: Time after which a connection without a HELLO is closed, s.


class ShmWriter:
    """Writer of messages into shared memory, on the node's loop, which notifies subscribers of this host.

    Subscribers connect to the socket at `address`, which `announce` shows in the graph.
    """

    def __init__(
        self,
        bridge: LoopBridge,
        endpoint: RawEndpoint,
        *,
        address: str,
        announce: Callable[[], GraphEntry],
        notify: Callable[[], None],
    ) -> None:
        self._bridge = bridge
        self._topic = endpoint.name
        self._limit_bytes = endpoint.max_message_bytes
        self._notify = notify
        self._sequence = 0
        arena_bytes = wire.HEADER_BYTES + ARENA_MESSAGES * slot_capacity(self._limit_bytes)
        self._pool = SlotPool(arena_bytes)
        self._fanout = Fanout(self._pool, _history_depth(endpoint.qos))
        self._arena = wire.OwnArena(arena_bytes, f"sfglab {self._topic}")
        self._connections: dict[int, socket] = {}
        self._watched: set[int] = set()
        self._greeted: set[int] = set()  # connections whose HELLO has arrived
        self._hangups = select.epoll()
        self._listener = wire.listen(address)
        bridge.watch(self._hangups.fileno(), self._on_hangup)
        bridge.watch(self._listener.fileno(), self._accept)
        self._announced = announce()
        self.gid = self._announced.gid

    @property
    def matched(self) -> int:
        """Number of connected subscribers."""
        return len(self._fanout.peers)

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """Empty set, because a HELLO does not contain the GUID of the subscriber."""
        return frozenset()

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Copy serialized bytes into shared memory and announce them; see `Publisher.publish_raw`."""
        data = memoryview(cdr).cast("B")
        if self._wanted(len(data)):
            offset = self._acquire(len(data))
            self._arena.view(offset, len(data))[:] = data
            self._announce(offset, len(data), source_timestamp_ns)

    def write_message(self, message: Any) -> None:
        """Serialize a message into shared memory and announce it; see `write`."""
        size = serialized_size(message)
        if self._wanted(size):
            with self.loan(size) as buffer:
                serialize_into(message, buffer)

    @contextmanager
    def loan(self, size_bytes: int) -> Iterator[memoryview]:
        """Lend the memory of the next message; see `Publisher.loan`."""
        check_size(self._topic, size_bytes, self._limit_bytes)
        offset = self._acquire(size_bytes)
        try:
            yield self._arena.view(offset, size_bytes)
        except BaseException:
            self._pool.release(offset)
            raise
        self._announce(offset, size_bytes, None)

    def close(self) -> None:
        """Disconnect all subscribers and free the memory; repeated calls are harmless."""
        if self._listener.fileno() < 0:
            return
        self._announced.close()
        for fd in (self._listener.fileno(), self._hangups.fileno(), *self._connections):
            self._bridge.unwatch(fd)
        for connection in self._connections.values():
            connection.close()
        self._connections.clear()
        self._listener.close()
        self._hangups.close()
        self._arena.close()

    def _wanted(self, size: int) -> bool:
        check_size(self._topic, size, self._limit_bytes)
        self._collect()
        if self._fanout.idle:
            self._sequence += 1
        return not self._fanout.idle

    def _acquire(self, size: int) -> int:
        while (slot := self._pool.acquire(size)) is None:
            if not self._fanout.shed():
                reason = f"subscribers hold all {self._pool.arena_bytes} bytes of shared memory and must release messages"
                raise PublishError(self._topic, code=_ENOSPC, reason=reason)
        offset, added = slot
        if added:
            self._reserve(offset, added)
        return offset

    def _reserve(self, offset: int, size: int) -> None:
        try:
            self._arena.reserve(offset, size)
        except OSError as error:
            self._pool.release(offset)
            raise PublishError(
                self._topic, code=error.errno or _ENOSPC, reason=str(error)
            ) from error

    def _announce(self, offset: int, size: int, source_timestamp_ns: int | None) -> None:
        self._sequence += 1
        stamp_ns = time.time_ns() if source_timestamp_ns is None else source_timestamp_ns
        announcement = Announcement(self._sequence, offset, size, stamp_ns)
        self._arena.set_latest(self._sequence)
        datagram = pack_announcement(announcement)
        for key in self._fanout.publish(announcement):
            self._send(key, announcement, datagram)
        for key in self._fanout.peers:
            if self._fanout.backlog(key) and key not in self._watched:
                self._watched.add(key)
                self._bridge.watch(key, partial(self._on_returns, key))

    def _send(self, key: int, announcement: Announcement, datagram: bytes) -> None:
        try:
            self._connections[key].send(datagram)
        except BlockingIOError:
            self._fanout.refuse(key, announcement)
        except OSError:
            self._hang_up(key)

    def _collect(self) -> None:
        """Take back returned slots; they wake the loop only while messages wait for their subscriber."""
        for key in self._fanout.peers:
            if self._fanout.holds(key):
                self._receive(key)

    def _receive(self, key: int) -> None:
        connection = self._connections[key]
        try:
            while datagram := connection.recv(RETURN_BYTES + 1):
                for offset in unpack_returns(datagram):
                    for announcement in self._fanout.returned(key, offset):
                        self._send(key, announcement, pack_announcement(announcement))
                    if key not in self._connections:
                        return  # the subscriber had disconnected after its last return
                if not self._fanout.holds(key):
                    return  # nothing more can come, and the return saves a system call
            self._leave(key)
        except BlockingIOError:
            return
        except (OSError, ProtocolError, KeyError) as error:
            _log.warning("topic %r: hanging up on a subscriber: %r", self._topic, error)
            self._hang_up(key)

    def _on_returns(self, key: int) -> None:
        if key in self._connections:
            self._receive(key)
        if not self._fanout.backlog(key):
            self._watched.discard(key)
            self._bridge.unwatch(key)

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError as error:
            if (
                error.errno in _NONE_LEFT
            ):  # the listener stays readable: an immediate retry would spin
                self._bridge.unwatch(self._listener.fileno())
                self._bridge.loop.call_later(_AGAIN_S, self._listen_again)
            return  # otherwise the subscriber has disconnected already
        connection.setblocking(False)
        if not wire.same_user(connection):
            connection.close()
            return
        self._connections[connection.fileno()] = connection
        self._bridge.watch(connection.fileno(), partial(self._on_hello, connection.fileno()))
        self._bridge.loop.call_later(HELLO_S, self._hang_up_on_the_silent, connection)

    def _listen_again(self) -> None:
        if self._listener.fileno() >= 0:
            self._bridge.watch(self._listener.fileno(), self._accept)

    def _hang_up_on_the_silent(self, connection: socket) -> None:
        key = connection.fileno()
        if self._connections.get(key) is connection and key not in self._greeted:
            self._hang_up(key)

    def _on_hello(self, key: int) -> None:
        connection = self._connections[key]
        self._bridge.unwatch(key)
        try:
            hello = wire.unpack_hello(connection.recv(wire.HELLO_BYTES + 1))
            send_fds(connection, [wire.pack_welcome(self.gid)], [self._arena.reader_fd])
        except (OSError, ProtocolError) as error:
            _log.warning("topic %r: refusing a subscriber: %s", self._topic, error)
            self._hang_up(key)
            return
        self._greeted.add(key)
        self._hangups.register(key, select.EPOLLRDHUP)
        for announcement in self._fanout.join(key, hello.depth, wants_history=hello.wants_history):
            self._send(key, announcement, pack_announcement(announcement))
        self._notify()

    def _on_hangup(self) -> None:
        for key, events in self._hangups.poll(0):
            if events & select.EPOLLHUP:
                self._hang_up(key)
            else:
                self._leave(key)

    def _leave(self, key: int) -> None:
        """Send a closed subscription nothing more, but leave its process the messages that it still holds."""
        self._hangups.modify(key, 0)  # EPOLLHUP is always reported
        self._bridge.unwatch(key)
        self._watched.discard(key)
        self._fanout.leaving(key)
        self._notify()

    def _hang_up(self, key: int) -> None:
        connection = self._connections.pop(key, None)
        if connection is None:
            return
        self._bridge.unwatch(key)
        self._watched.discard(key)
        self._greeted.discard(key)
        self._fanout.gone(key)
        connection.close()  # this also removes it from the epoll set
        self._notify()


def _history_depth(qos: QoSProfile) -> int | None:
    if qos.durability is Durability.VOLATILE:
        return 0
    return qos.depth if qos.history is History.KEEP_LAST else None
