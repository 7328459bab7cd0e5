"""A middleware as nodes see it: the base class of its half of a node, and forwarding between two of them.

Knows what ends with a node and in which order. Refuses to know any middleware: each derives from `Backend`.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from sfglab.bus.api import EndpointKind, Listener, RawEndpoint
from sfglab.bus.endpoints import Inbox, Reader, Sample, Writer
from sfglab.bus.forwarding import Forward, Forwarder, Transform
from sfglab.bus.loop import Calls, LoopBridge, OnError, nothing
from sfglab.bus.ros.services import RosServices
from sfglab.messages import decoder

if TYPE_CHECKING:
    from sfglab.bus.graph import Graph


class Clock:
    """The time of a node's world: here the host's, as ROS 2 stamps messages with it."""

    def now_ns(self) -> int:
        """Return the current time, in nanoseconds since the Unix epoch."""
        return time.time_ns()

    async def sleep_for(self, duration_s: float) -> None:
        """Return after `duration_s` seconds of this clock."""
        await asyncio.sleep(duration_s)


class Backend(ABC):
    """One node's half of a middleware, on the running loop; what is opened and registered here ends with it.

    Nothing here refers to the `Node`, so one that a notebook forgot is collected, and its finalizer closes the
    backend. `on_error` is told about exceptions in callbacks; None logs them.
    """

    kind: ClassVar[str]  #: What nodes of it are called in error messages.
    graph: Graph  #: All endpoints of the node's domain.
    guid: bytes  #: The 16-byte GUID of the node's participant.
    ros: RosServices  #: Services of rmw_fastrtps in the node's domain.

    def __init__(self, on_error: OnError | None) -> None:
        self.loop = asyncio.get_running_loop()
        self.bridge = LoopBridge(self.loop)  #: Where other threads post to.
        self.clock = Clock()
        self.closed = False
        self.ros = RosServices(self.calls)
        self._on_error = on_error
        self._owned: dict[Callable[[], None], None] = {}
        self._tasks: set[asyncio.Task[Any]] = set()

    @abstractmethod
    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer; on the loop `notify` is called when its matching readers change."""

    @abstractmethod
    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader, which pushes into `inbox`; see `open_writer`."""

    @abstractmethod
    def leave(self) -> None:
        """Leave the domain; everything registered is closed."""

    def open_forwarder(self, target: Any) -> Forwarder:
        """Return what forwards to another node of this kind; `target` is its backend."""
        return RawForwarder(self, target)

    def decoder(self, type_: str) -> Callable[[Any], Any]:
        """Return what makes messages of a type from CDR."""
        return decoder(type_)

    def random_bytes(self, count: int) -> bytes:
        """Return bytes that no other node will have."""
        return secrets.token_bytes(count)

    def watch_publishers(
        self, reader: Reader, endpoint: RawEndpoint, listener: Listener
    ) -> Callable[[], None]:
        """Tell a listener of publishers that may not match a reader, and why; return what ends that."""
        del reader
        return self.graph.watch(endpoint.dds_topic, EndpointKind.PUBLISHER, listener)

    def calls(self, where: str) -> Calls:
        """Return a runner for the callbacks of one endpoint."""
        return Calls(self._tasks, where, self._on_error)

    def register(self, close: Callable[[], None]) -> None:
        """Call `close` when the node closes."""
        self._owned[close] = None

    def end(self, close: Callable[[], None]) -> None:
        """Call a registered `close` before the node closes; again, and after that, it is harmless."""
        if not self.closed and close in self._owned:
            del self._owned[close]
            close()

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
        for close in reversed(list(self._owned)):
            close()
        self._owned.clear()
        if not self.loop.is_closed():
            self.graph.close()
            current = asyncio.current_task() if _running_loop() is not None else None
            for task in self._tasks - {current}:
                task.cancel()
        self.leave()


class RawForwarder:
    """Forwards from one node to another by readers and writers of theirs, all on the loop."""

    def __init__(self, source: Backend, target: Backend) -> None:
        self._source = source
        self._target = target

    def open(self, endpoint: RawEndpoint) -> LoopForward:
        """Read a topic in the source's domain; until its sources are judged their samples are held."""
        return LoopForward(self._source, replace(endpoint, forwards=True))

    def open_writer(self, endpoint: RawEndpoint) -> LoopWriter:
        """Write to a topic in the target's domain."""
        return LoopWriter(self._target, replace(endpoint, forwards=True))


class LoopWriter:
    """A raw writer that is written to on the loop, and ignores what comes after its end."""

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        self._backend = backend
        self._writers = [
            backend.open_writer(replace(endpoint, transport=transport), nothing)
            for transport in (
                ("dds", "ros") if endpoint.transport == "any" else (endpoint.transport,)
            )
        ]
        self.gid = self._writers[0].gid
        for writer in self._writers:
            backend.register(writer.close)

    def write(self, cdr: bytes, source_timestamp_ns: int) -> None:
        """Send one sample with the time stamp that its first publisher gave it."""
        if not self._backend.closed:
            for writer in self._writers:
                writer.write(cdr, source_timestamp_ns)

    def close(self) -> None:
        """End it; again is harmless."""
        while self._writers:
            self._backend.end(self._writers.pop().close)


class LoopForward(Forward[Sample, LoopWriter]):
    """A forward whose samples pass on the loop; half a server waits for that of rmw_fastrtps, if one comes."""

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        super().__init__()
        self._backend = backend
        self._reader: Reader | None = None
        self._closed = False
        backend.ros.when_settled(endpoint, partial(self._open, endpoint))

    def close(self) -> None:
        """End it at once; again is harmless."""
        self._closed = True
        if self._reader is not None:
            self._backend.end(self._reader.close)
        self._gate.close()

    def _open(self, endpoint: RawEndpoint) -> None:
        if self._closed or self._backend.closed:
            return
        calls = self._backend.calls(f"raw reader {endpoint.dds_topic!r}")
        inbox = Inbox(
            self._backend.bridge, endpoint.qos, decode=lambda s: s, callback=self._take, calls=calls
        )
        self._reader = self._backend.open_reader(endpoint, nothing, inbox)
        self._backend.register(self._reader.close)

    def _take(self, sample: Sample) -> None:
        self._gate.take(sample[3], sample)

    def _send(self, exit_: tuple[LoopWriter, Transform | None], sample: Sample) -> None:
        writer, transform = exit_
        cdr = bytes(sample[0])
        changed = cdr if transform is None else transform(cdr)
        if changed is None:
            self._drop(sample)
            return
        writer.write(changed, sample[1])
        self.counts.forwarded += 1
        self.counts.bytes += len(changed)

    def _drop(self, sample: Sample) -> None:
        del sample
        self.counts.dropped += 1


Join = Callable[[str, OnError | None], Backend]  #: Given a node's full name and its errors' taker.


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None
