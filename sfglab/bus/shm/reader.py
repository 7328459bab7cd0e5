"""Shared-memory subscription: a connection and a map for every publisher of its topic on this host."""

from __future__ import annotations

import logging
import os
import socket
import time
import weakref
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import SHM_KEY, EndpointAdded, EndpointKind, entries, host_id
from sfglab.bus.errors import BusError
from sfglab.bus.loop import nothing
from sfglab.bus.shm import wire
from sfglab.bus.shm.fanout import SHARES, credits_of, returns_of
from sfglab.bus.shm.wire import (
    ANNOUNCE_BYTES,
    RETURN_MAX,
    ArenaMap,
    pack_returns,
    unpack_announcement,
)
from sfglab.qos import Durability, History, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import EndpointEvent, EndpointInfo, RawEndpoint
    from sfglab.bus.endpoints import GraphEntry, Inbox, SampleQueue
    from sfglab.bus.graph import Graph
    from sfglab.bus.loop import LoopBridge, WatchThread

_log = logging.getLogger(__name__)
_RETRY_S = 0.02

#: Number of messages that an application may keep beside its queue before it receives copies.
_IN_HAND = 2

# Closed links whose messages are still in use; the references keep their sockets open.
_lingering: set[_Link] = set()


class _Reference(weakref.ref[Any]):
    """Weak reference to a message's bytes, with the offset of their slot."""

    __slots__ = ("offset",)
    offset: int


class _Link:
    """Connection and map of one publisher, and the slots of it that this process holds.

    The last view of a message may end in any thread. The release of a slot is therefore one dictionary
    operation and one datagram.
    """

    def __init__(self, sock: socket.socket, credits_: int) -> None:
        self.sock = sock
        self._credits = credits_
        self._together = returns_of(credits_)
        self._urgent = credits_ - self._together
        self.gid = bytes(16)
        self.arena: ArenaMap | None = None
        self.last_sequence = 0
        self.held: dict[int, _Reference] = {}
        self.unsent: list[int] = []
        self._out: dict[int, int] = {}  # offset -> size of slots that the publisher counts as held
        # whether a message was so large that one more than the credits of its size exceeds a share
        self._has_large = False

    def take(self, arena: ArenaMap, offset: int, size: int, queue: SampleQueue) -> memoryview:
        """Return an announced message, whose last view returns its slot; a copy if many messages are held."""
        is_last = self.told(offset, size, arena.size_bytes)
        array = arena.slice(offset, size)
        reference = self.held[offset] = _Reference(array, self._let_go)
        reference.offset = offset
        data = memoryview(array)
        if is_last and len(self.held) - len(queue) > _IN_HAND:
            return memoryview(bytes(data))  # the last slot must return at once
        return data

    def told(self, offset: int, size: int, arena_bytes: int) -> bool:
        """Note an announcement; return whether the publisher may send no more until a slot is returned."""
        self._out[offset] = size
        if size * (self._credits + 1) * SHARES > arena_bytes:
            self._has_large = True
        return len(self._out) >= self._credits or (self._has_large and self._is_share_full())

    def _is_share_full(self) -> bool:
        """Return whether one more message as large as the largest here may exceed a share."""
        if not self._has_large or self.arena is None:
            return False
        sizes = self._out.values()
        return sum(sizes) + max(sizes, default=0) > self.arena.size_bytes // SHARES

    def give_back(self, offset: int) -> None:
        """Return a slot to the publisher, together with a few others unless it may be waiting for them."""
        self.unsent.append(offset)
        few = len(self.unsent) < self._together and len(self.held) + len(self.unsent) < self._urgent
        if few and not self._is_share_full():
            return
        offsets: list[int] = []
        with suppress(IndexError):  # another thread may empty the list meanwhile
            while len(offsets) < RETURN_MAX:
                offsets.append(self.unsent.pop())
        if not offsets:
            return
        back = {
            slot: self._out.pop(slot, 0) for slot in offsets
        }  # before the send: a slot may be announced again at once
        try:
            self.sock.send(pack_returns(offsets))
        except BlockingIOError:
            self.unsent.extend(offsets)  # they are sent with the next slot
            self._out |= back
        except OSError:
            return  # the publisher has gone and needs no slot

    def close(self) -> None:
        """Disconnect; while messages are held, end only sending, so that the publisher keeps their slots."""
        if self.held:
            _lingering.add(self)
            with suppress(OSError):  # the publisher has disconnected first
                self.sock.shutdown(socket.SHUT_WR)
        else:
            self.sock.close()

    def _let_go(self, reference: _Reference) -> None:
        del self.held[reference.offset]
        self.give_back(reference.offset)
        if self in _lingering and not self.held:
            _lingering.discard(self)
            self.sock.close()


class ShmReader:
    """Reader that connects to every matching publisher of this host; `watcher` receives the datagrams."""

    def __init__(
        self,
        watcher: LoopBridge | WatchThread,
        endpoint: RawEndpoint,
        *,
        announce: Callable[[], GraphEntry],
        inbox: Inbox,
        notify: Callable[[], None],
    ) -> None:
        self._watcher = watcher
        self._endpoint = endpoint
        self._qos = qos = endpoint.qos
        self._depth = qos.depth if qos.history is History.KEEP_LAST else 0
        self._credits = credits_of(self._depth)
        self._inbox = inbox
        self._notify = notify
        self._links: dict[bytes, _Link] = {}
        self._closed = False
        self.lost = 0
        self._announced = announce()
        self.gid = self._announced.gid
        self._unlisten: Callable[[], None] = nothing

    @property
    def matched(self) -> int:
        """Number of connected publishers."""
        return sum(link.arena is not None for link in self._links.values())

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """GUID prefixes of the participants of connected publishers."""
        return frozenset(link.gid[:12] for link in self._links.values() if link.arena is not None)

    def follow(self, graph: Graph) -> None:
        """Connect to the present and future publishers of a graph."""
        self._unlisten = graph.watch(
            self._endpoint.dds_topic, EndpointKind.PUBLISHER, self._on_graph
        )

    def close(self) -> None:
        """Disconnect; messages that the application holds stay valid. Repeated calls are harmless."""
        if self._closed:
            return
        self._closed = True
        self._unlisten()
        # The function refers to this reader, which is freed at once without it.
        self._unlisten = nothing
        self._announced.close()
        self._watcher.run_in_thread(partial(self._leave, tuple(self._links.values())))
        self._links.clear()

    def _on_graph(self, event: EndpointEvent) -> None:
        endpoint = event.endpoint
        if (
            isinstance(event, EndpointAdded)
            and endpoint.gid not in self._links
            and self._matches(endpoint)
        ):
            self._connect(endpoint)

    def _matches(self, endpoint: EndpointInfo) -> bool:
        return (
            endpoint.transport == "shm"
            and endpoint.type == self._endpoint.type
            and endpoint.host == host_id()
            and not incompatibilities(offered=endpoint.qos, requested=self._qos)
        )

    def _connect(self, endpoint: EndpointInfo) -> None:
        if self._closed or endpoint.gid in self._links:
            return
        try:
            sock = wire.connect(entries(endpoint.user_data).get(SHM_KEY, ""))
        except BlockingIOError:  # many connect at once, and the publisher's queue is full
            self._watcher.loop.call_later(_RETRY_S, self._connect, endpoint)
            return
        except OSError:
            return  # the publisher has gone, as the graph will report soon
        if not wire.same_user(sock):
            _log.warning("topic %r: a publisher of another user is ignored", self._endpoint.name)
            sock.close()
            return
        link = self._links[endpoint.gid] = _Link(sock, self._credits)
        wants_history = self._qos.durability is Durability.TRANSIENT_LOCAL
        sock.send(wire.pack_hello(wire.Hello(self._depth, wants_history)))
        self._watcher.watch(sock.fileno(), partial(self._receive, endpoint.gid, link))

    def _receive(self, gid: bytes, link: _Link) -> None:
        try:
            arena = link.arena or self._welcome(link)
            while datagram := link.sock.recv(ANNOUNCE_BYTES + 1):
                sequence, offset, size, stamp_ns = unpack_announcement(datagram, arena.size_bytes)
                latest = arena.latest[0]
                if sequence != link.last_sequence + 1 and link.last_sequence:
                    self._inbox.queue.skip(sequence - link.last_sequence - 1)
                link.last_sequence = sequence
                if self._depth and latest - sequence >= self._depth:
                    # This process was late, and newer messages wait at the publisher: KEEP_LAST keeps those.
                    self._inbox.queue.skip(1)
                    link.told(offset, size, arena.size_bytes)
                    link.give_back(offset)
                else:
                    data = link.take(arena, offset, size, self._inbox.queue)
                    self._inbox.push((data, stamp_ns, time.time_ns(), link.gid))
                if sequence >= latest or self._closed:
                    return  # usually this is the latest message, and the return saves a system call
            self._drop(gid, link)
        except BlockingIOError:
            return
        except OSError:
            self._drop(gid, link)  # the publisher was killed before it read our returns
        except BusError as error:
            _log.warning("topic %r: dropping a publisher: %r", self._endpoint.name, error)
            self._drop(gid, link)

    def _welcome(self, link: _Link) -> ArenaMap:
        datagram, fds, _, _ = socket.recv_fds(link.sock, 64, 1)
        try:
            if not datagram:
                raise ConnectionResetError("the publisher hung up")
            link.gid = wire.unpack_welcome(datagram)
            if len(fds) != 1:
                raise wire.ProtocolError(datagram, "one memory file with the welcome")
            link.arena = ArenaMap(fds[0])
        finally:
            for fd in fds:
                os.close(fd)
        self._watcher.run_on_loop(self._notify)
        return link.arena

    def _leave(self, links: tuple[_Link, ...]) -> None:
        for link in links:
            self._watcher.unwatch(link.sock.fileno())
            link.close()

    def _drop(self, gid: bytes, link: _Link) -> None:
        self._watcher.unwatch(link.sock.fileno())
        link.sock.close()
        self._watcher.run_on_loop(partial(self._forget, gid))

    def _forget(self, gid: bytes) -> None:
        self._links.pop(gid, None)
        self._notify()
