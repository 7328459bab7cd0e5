"""Base class of backends, one for each middleware, and forwarding between nodes of any two backends.

A backend closes what its node opened, in reverse order. Each middleware derives a class from `Backend`; this
module depends on none of them.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, ClassVar

from sfglab.bus.endpoints import Inbox, Reader, Sample, Writer
from sfglab.bus.errors import WriterBlockedError
from sfglab.bus.forwarding import Forward, Forwarder, GuardedWriter, Transform
from sfglab.bus.loop import CallbackRunner, LoopBridge, nothing
from sfglab.bus.ros.services import RosServices

if TYPE_CHECKING:
    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.graph import Graph
    from sfglab.qos import QoSProfile


# Pause after which a blocked sample is sent again, s.
_RETRY_S = 0.01


class Clock:
    """Clock of a node: here the system time of the host, with which ROS 2 stamps messages."""

    def now_ns(self) -> int:
        """Return the current time, in nanoseconds since the Unix epoch."""
        return time.time_ns()

    async def sleep_for(self, duration_s: float) -> None:
        """Return after `duration_s` seconds of this clock."""
        await asyncio.sleep(duration_s)


class Backend(ABC):
    """Backend of one node, on the running loop; its end closes everything that was opened or registered here.

    A node gets its backend from `Join`. A backend holds no reference to its `Node`. A forgotten node is
    therefore collected, and its finalizer closes the backend. Exceptions of callbacks are logged. All backends
    follow these rules:

    - An endpoint has a 16-byte GID. `participant_of` returns the participant's part of it, as in
      `matched_prefixes`.
    - Graphs of other nodes show an endpoint's QoS, node and USER_DATA. Only endpoints with compatible QoS match
      (`sfglab.qos.incompatibilities`). The backend checks this if its middleware does not.
    - A sample carries its source time and its publisher's GID. Requests and replies are samples with a frame
      (`sfglab.messages.frame_service`).
    - A reader calls `Inbox.on_life` when a publisher appears, becomes alive again, or loses its liveliness.
    """

    kind: ClassVar[str]  #: Word for nodes of this backend in error messages, such as "live".
    graph: Graph  #: Graph of the node's domain.
    guid: bytes  #: 16-byte GUID of the node's participant.

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.bridge = LoopBridge(self.loop)  #: Bridge over which other threads reach the loop.
        self.clock = Clock()
        self.closed = False
        self._owned: dict[Callable[[], None], None] = {}
        self._tasks: set[asyncio.Task[Any]] = set()

    @abstractmethod
    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer; `notify` is called on the loop when its matching readers change."""

    @abstractmethod
    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader that pushes samples into `inbox`; `notify` is called when its matching writers change."""

    @abstractmethod
    def leave(self) -> None:
        """Leave the domain; everything registered is closed by then."""

    def open_forwarder(self, target: Any) -> Forwarder:
        """Return a forwarder to another node of this kind; `target` is the backend of that node."""
        return RawForwarder(self, target)

    @cached_property
    def ros(self) -> RosServices:
        """Services of rmw_fastrtps in the node's domain; this base class cannot reach any."""
        return RosServices(self.calls)

    def participant_of(self, gid: bytes) -> bytes:
        """Return the part of an endpoint's GID that names its participant."""
        return gid[:12]

    def random_bytes(self, count: int) -> bytes:
        """Return random bytes that are unique among nodes."""
        return secrets.token_bytes(count)

    def calls(self, where: str) -> CallbackRunner:
        """Return a runner for the callbacks of one endpoint."""
        return CallbackRunner(self._tasks, where)

    def register(self, close: Callable[[], None]) -> None:
        """Register a function that is called when the node closes, unless `end` has called it before."""
        self._owned[close] = None

    def end(self, close: Callable[[], None]) -> None:
        """Call a registered `close` now; harmless if it was called before or the node is closed."""
        if not self.closed and close in self._owned:
            del self._owned[close]
            close()

    def close(self) -> None:
        """Close everything now; callable from any thread, without a running loop, and repeatedly."""
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
            current = asyncio.current_task() if _running_loop() is not None else None
            for task in self._tasks - {current}:
                task.cancel()
        self.leave()


class RawForwarder:
    """Forwarder between nodes of any two backends; samples pass through readers and writers on the loop."""

    def __init__(self, source: Backend, target: Backend) -> None:
        self._source = source
        self._target = target

    def open(self, endpoint: RawEndpoint) -> LoopForward:
        """Read a topic in the source domain; samples of a source are held until it is admitted or refused."""
        return LoopForward(self._source, replace(endpoint, forwards=True))

    def open_writer(self, endpoint: RawEndpoint) -> LoopWriter:
        """Write to a topic in the target domain."""
        return LoopWriter(self._target, replace(endpoint, forwards=True))


class LoopWriter(GuardedWriter):
    """Raw writer for use on the loop, which ignores samples after its end.

    A KEEP_ALL writer may block on slow readers. It is therefore called in a thread, and a blocked sample is
    sent again.
    """

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        super().__init__(endpoint.qos)
        self._backend = backend
        self._endpoint = endpoint
        self._writers: list[Writer] = []
        self._leaving: list[Writer] = []  # writers without a source, until their samples are sent
        self._create(endpoint.qos)
        self.gid = self._writers[0].gid
        blocking = any(getattr(writer, "may_block", False) for writer in self._writers)
        self._may_block = blocking and not endpoint.is_service
        self._calls = backend.calls(f"raw writer {endpoint.dds_topic!r}")
        self._unsent: deque[tuple[bytes, int]] = deque()
        self._sending: asyncio.Task[Any] | None = None

    def write(self, cdr: bytes, source_timestamp_ns: int) -> None:
        """Send one sample with the source time stamp of its original publisher."""
        if self._backend.closed or self.closed:
            return
        self.show_life(alive=True)
        self.bound_backlog(len(cdr))
        if not self._may_block:
            self._write(cdr, source_timestamp_ns)
            return
        self._unsent.append((cdr, source_timestamp_ns))
        if self._sending is None:
            self._sending = self._calls.spawn(self._send())

    def sent(self) -> Awaitable[None] | None:
        """Return an awaitable that ends when all samples are sent; None if they are."""
        return None if self._sending is None else _ended(self._sending)

    def close(self) -> None:
        """Close the writer; repeated calls are harmless."""
        self.closed = True
        self._delete()
        if self._sending is not None and not self._backend.loop.is_closed():
            self._sending.cancel()

    def _create(self, qos: QoSProfile) -> None:
        transport = self._endpoint.transport
        transports: tuple[Any, ...] = ("dds", "ros") if transport == "any" else (transport,)
        self._end_leaving()
        for one in transports:
            endpoint = replace(self._endpoint, qos=qos, transport=one)
            writer = self._backend.open_writer(endpoint, nothing)
            self._backend.register(writer.close)
            self._writers.append(writer)

    def _delete(self) -> None:
        self._leaving += self._writers
        self._writers = []
        if self.closed or not self._unsent:
            self._end_leaving()

    def _end_leaving(self) -> None:
        while self._leaving:
            self._backend.end(self._leaving.pop().close)

    def _has_all_acknowledged(self) -> bool:
        asked = [getattr(writer, "acknowledged", lambda: True) for writer in self._writers]
        return all(has_all() for has_all in asked)

    def _write(self, cdr: bytes, source_timestamp_ns: int) -> None:
        for writer in self._writers or self._leaving:
            writer.write(cdr, source_timestamp_ns)

    async def _send(self) -> None:
        """Send queued samples in a thread; a sample that slow readers block is sent again."""
        try:
            while self._unsent:
                try:
                    await asyncio.to_thread(self._write, *self._unsent[0])
                except WriterBlockedError:
                    await asyncio.sleep(_RETRY_S)
                    continue
                except Exception as error:  # noqa: BLE001 - one bad sample must not stop the next ones
                    self._calls.report(error)
                self._unsent.popleft()
            self._end_leaving()
        finally:
            self._sending = None


class LoopForward(Forward[Sample, LoopWriter]):
    """Forward whose samples pass on the loop; its reader opens when `RosServices.when_settled` allows it."""

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        super().__init__()
        self._backend = backend
        self._reader: Reader | None = None
        self._closed = False
        self._blocking: LoopWriter | None = None
        self._calls = backend.calls(f"forward of {endpoint.dds_topic!r}")
        backend.ros.when_settled(endpoint, partial(self._open, endpoint))

    def close(self) -> None:
        """Close the forward at once; repeated calls are harmless."""
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
        inbox.on_life = self._show_life
        self._reader = self._backend.open_reader(endpoint, nothing, inbox)
        self._backend.register(self._reader.close)

    def _take(self, sample: Sample) -> Awaitable[None] | None:
        """Forward a sample; while its writer is blocked, the next ones wait in the inbox.

        A sample whose publisher has left may have the unknown GID, zeros. Such a sample is dropped because it
        has no source to decide about.
        """
        if not any(sample[3]):
            self._drop(sample)
            return None
        self._blocking = None
        self._gate.take(sample[3], sample)
        return None if self._blocking is None else self._blocking.sent()

    def _show_life(self, source: bytes, alive: bool) -> None:  # noqa: FBT001 - a callback's argument
        destination = self._gate.destination_of(source)
        if destination is not None:
            destination[0].show_life(alive=alive)

    def _send(self, destination: tuple[LoopWriter, Transform | None], sample: Sample) -> None:
        writer, transform = destination
        cdr = bytes(sample[0])
        try:
            changed = cdr if transform is None else transform(cdr)
            if changed is not None:
                writer.write(changed, sample[1])
        except Exception as error:  # noqa: BLE001 - one bad sample must not stop the next ones
            self._calls.report(error)
            changed = None
        if changed is None:
            self._drop(sample)
            return
        self._blocking = writer
        self.counts.forwarded += 1
        self.counts.bytes += len(changed)

    def _drop(self, sample: Sample) -> None:
        del sample
        self.counts.dropped += 1


async def _ended(task: asyncio.Task[Any]) -> None:
    """Return when a task has ended; a cancelled wait does not cancel the task."""
    await asyncio.wait((task,))


#: Function that creates the backend of a node, given its full name.
Join = Callable[[str], Backend]


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None
