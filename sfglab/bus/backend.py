"""A middleware as nodes see it: the base class of its half of a node, and what it forwards between nodes.

Knows what ends with a node and in which order. Refuses to know any middleware: DDS (`sfglab.bus.dds`), the
simulated world (`sfglab.bus.sim`) and any further one derive from `Backend`, and no component needs a change.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from sfglab.bus.api import EndpointKind, Listener, RawEndpoint
from sfglab.bus.errors import ClosedError
from sfglab.bus.loop import Calls, LoopBridge, OnError
from sfglab.messages import decoder

if TYPE_CHECKING:
    from sfglab.bus.endpoints import Inbox, Reader, Writer
    from sfglab.bus.graph import Graph

Transform = Callable[[bytes], bytes | None]
"""Changes a sample on its way: CDR in, CDR out, None drops it. The same object back means: as it was."""


class Clock:
    """The time of a node's world: here the host's, as ROS 2 stamps messages with it."""

    def now_ns(self) -> int:
        """Return the current time, in nanoseconds since the Unix epoch."""
        return time.time_ns()

    async def sleep_for(self, duration_s: float) -> None:
        """Return after `duration_s` seconds of this clock."""
        await asyncio.sleep(duration_s)


class Owned(Protocol):
    """Something that ends with its node."""

    def close(self) -> None:
        """Release what it holds."""


class RawWriter(Protocol):
    """A writer of samples as they are, in the target's domain of a forwarder."""

    @property
    def gid(self) -> bytes:
        """Its 16-byte GUID, as the graph shows it."""

    def close(self) -> None:
        """End it; again is harmless."""


@dataclass(slots=True)
class ForwardCounts:
    """What a forward did so far."""

    forwarded: int = 0  #: Samples handed to a raw writer.
    #: Samples that were not: of refused sources, by the transform, pushed out while they were held, or refused
    #: by the target's middleware.
    dropped: int = 0
    bytes: int = 0  #: Size of the CDR that was forwarded.


class Forward(Protocol):
    """One raw reader of one topic, whose samples go on by their source; made by `Forwarder.open`."""

    @property
    def gid(self) -> bytes:
        """The reader's 16-byte GUID."""

    @property
    def counts(self) -> ForwardCounts:
        """What it did so far."""

    def admit(self, source: bytes, writer: RawWriter, transform: Transform | None = None) -> None:
        """Send a source's samples to a raw writer from now on, those held for it first.

        Args:
            source: The 16-byte GUID of a publisher in the source's domain.
            writer: Made by the same forwarder.
            transform: Given each sample. On live nodes it runs in the thread that reads, so it must not
                touch what belongs to the loop.
        """

    def refuse(self, source: bytes) -> None:
        """Drop a source's samples from now on, and those held."""

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged: its samples are held, within bounds, until it is."""

    def close(self) -> None:
        """End it at once: nothing is forwarded any more; raw writers stay. Again is harmless."""


class Forwarder(Protocol):
    """Opens forwards from one node and raw writers on another; made by `Node.open_forwarder`."""

    def open(self, endpoint: RawEndpoint) -> Forward:
        """Read a topic in the source's domain; until its sources are judged their samples are held."""

    def open_writer(self, endpoint: RawEndpoint) -> RawWriter:
        """Write to a topic in the target's domain; to be closed when no source goes there any more."""


class Backend(ABC):
    """One node's half of a middleware, on the running loop; what is opened and registered here ends with it.

    Threads, callbacks and sockets refer to the backend and never to the `Node`, so a node that a notebook
    forgot is collected, and its finalizer closes the backend.

    Args:
        on_error: Told about exceptions in callbacks; None logs them.
    """

    kind: ClassVar[str]  #: What nodes of it are called in error messages.
    graph: Graph  #: All endpoints of the node's domain.
    guid: bytes  #: The 16-byte GUID of the node's participant.

    def __init__(self, on_error: OnError | None) -> None:
        self.loop = asyncio.get_running_loop()
        self.bridge = LoopBridge(self.loop)  #: Where other threads post to.
        self.clock = Clock()
        self.closed = False
        self._on_error = on_error
        self._owned: dict[Owned, None] = {}
        self._tasks: set[asyncio.Task[Any]] = set()

    @abstractmethod
    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer; on the loop `notify` is called when its matching readers change."""

    @abstractmethod
    def open_reader(self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox) -> Reader:
        """Return a new reader, which pushes into `inbox`; see `open_writer`."""

    @abstractmethod
    def open_forwarder(self, target: Any) -> Forwarder:
        """Return what forwards to another node of this kind; `target` is its backend."""

    @abstractmethod
    def leave(self) -> None:
        """Leave the domain; everything registered is closed."""

    def decoder(self, type_: str) -> Callable[[Any], Any]:
        """Return what makes messages of a type from CDR."""
        return decoder(type_)

    def random_bytes(self, count: int) -> bytes:
        """Return bytes that no other node will have."""
        return secrets.token_bytes(count)

    def watch_publishers(self, reader: Reader, endpoint: RawEndpoint, listener: Listener) -> Callable[[], None]:
        """Tell a listener of publishers that may not match a reader, and why; return what ends that."""
        del reader
        return self.graph.watch(endpoint.dds_topic, EndpointKind.PUBLISHER, listener)

    def calls(self, where: str) -> Calls:
        """Return a runner for the callbacks of one endpoint."""
        return Calls(self._tasks, where, self._on_error)

    def register(self, thing: Owned) -> None:
        """Close `thing` when the node closes."""
        self._owned[thing] = None

    def end(self, thing: Owned) -> None:
        """Close a registered thing before its node; again, and after the node's end, it is harmless."""
        if not self.closed and thing in self._owned:
            del self._owned[thing]
            thing.close()

    def check_open(self, what: str) -> None:
        """Refuse the use of something whose node has ended.

        Raises:
            ClosedError: It has.
        """
        if self.closed:
            raise ClosedError(what)

    def close(self) -> None:
        """End everything now; from any thread, also without a running loop; again is harmless."""
        if self.closed:
            return
        self.closed = True
        if self.loop.is_running() and _running_loop() is not self.loop:
            self.loop.call_soon_threadsafe(self._end_all)
        else:
            self._end_all()

    async def ended(self) -> None:
        """Return when the callbacks that `close` cancelled have ended."""
        tasks = self._tasks - {asyncio.current_task()}
        if tasks:
            await asyncio.wait(tasks)

    def _end_all(self) -> None:
        for thing in reversed(list(self._owned)):
            thing.close()
        self._owned.clear()
        if not self.loop.is_closed():
            self.graph.close()
            current = asyncio.current_task() if _running_loop() is not None else None
            for task in self._tasks - {current}:
                task.cancel()
        self.leave()


Join = Callable[[str, OnError | None], Backend]
"""Joins a middleware for a node of this full name; exceptions of its callbacks go to the second."""


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None
