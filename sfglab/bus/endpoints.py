"""Endpoints of a backend: writers, readers, and the bounded inbox between a reader and its user."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from sfglab.bus.errors import ClosedError
from sfglab.bus.loop import JOIN_S, CallbackRunner, LoopBridge, nothing
from sfglab.qos import History, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.bus.api import Callback

#: Largest queue of a KEEP_ALL subscription, bytes; beyond it the oldest samples are dropped.
KEEP_ALL_LIMIT_BYTES = 256 * 2**20

Sample = tuple[bytes | memoryview, int, int, bytes]
"""CDR, source time (ns), reception time (ns), publisher's GID; a plain tuple, made for each message."""

# CPython's memory for the bookkeeping of a queued sample, so that a flood of empty messages is bounded as well.
_OVERHEAD_BYTES = 256
# Number of samples in a row, and time of their callbacks (s), after which a reader yields the loop to other tasks.
_MAX_PER_WAKE, _MAX_BUSY_S = 32, 0.005


class Endpoint(Protocol):
    """Writer or reader of one topic, open until it is closed."""

    @property
    def gid(self) -> bytes:
        """16-byte GUID of the endpoint, as other nodes discover it."""

    @property
    def matched(self) -> int:
        """Number of matching endpoints of the other kind."""

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """GUID prefixes of the participants whose endpoints match."""

    def close(self) -> None:
        """Close the endpoint and free its resources."""


class Writer(Endpoint, Protocol):
    """Outgoing endpoint, which sends samples to the matching readers of its topic."""

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes; see `Publisher.publish_raw`."""

    def write_message(self, message: Any) -> None:
        """Serialize a ROS message to CDR and send it; see `Publisher.publish`."""


class Reader(Endpoint, Protocol):
    """Incoming endpoint, which pushes samples into the inbox that it was opened with."""

    @property
    def lost(self) -> int:
        """Number of samples that the transport knows to be lost."""


class GraphEntry(Protocol):
    """Presence of a shared-memory endpoint in the graph."""

    @property
    def gid(self) -> bytes:
        """16-byte GUID of the endpoint."""

    def close(self) -> None:
        """Remove the endpoint from the graph."""


class SampleQueue:
    """First-in-first-out queue of `depth` samples, or of `limit_bytes` for KEEP_ALL; it drops the oldest.

    A transport's thread pushes under a lock, which protects the bounds. The loop pops without it because
    operations at the ends of a deque are thread-safe.
    """

    def __init__(self, qos: QoSProfile, *, limit_bytes: int = KEEP_ALL_LIMIT_BYTES) -> None:
        self._limit_bytes = limit_bytes if qos.history is History.KEEP_ALL else None
        self._samples: deque[Sample] = deque(maxlen=None if self._limit_bytes else qos.depth)
        self._lock = threading.Lock()
        self._arrived = self._taken = self._skipped = 0
        self._in_bytes = self._out_bytes = 0

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def dropped(self) -> int:
        """Number of samples that were dropped or skipped before they were read."""
        with self._lock:
            return self._skipped + self._arrived - self._taken - len(self._samples)

    def push(self, samples: Iterable[Sample]) -> None:
        """Append samples, oldest first."""
        with self._lock:
            for sample in samples:
                self._samples.append(sample)  # with KEEP_LAST this drops the oldest of a full queue
                self._arrived += 1
                if self._limit_bytes:
                    self._in_bytes += len(sample[0]) + _OVERHEAD_BYTES
                    self._shrink(self._limit_bytes)

    def pop(self) -> Sample | None:
        """Remove and return the oldest sample, None if there is none; to be called on the loop only."""
        try:
            sample = self._samples.popleft()
        except IndexError:
            return None
        self._taken += 1
        if self._limit_bytes:
            self._out_bytes += len(sample[0]) + _OVERHEAD_BYTES
        return sample

    def skip(self, count: int) -> None:
        """Count samples that a transport left out because newer ones were waiting."""
        self._skipped += count

    def clear(self) -> None:
        """Remove all samples without counting them as dropped; to be called on the loop only."""
        while self.pop() is not None:
            pass

    def _shrink(self, limit_bytes: int) -> None:
        while self._in_bytes - self._out_bytes > limit_bytes and len(self._samples) > 1:
            oldest = self._samples.popleft()
            if not self._samples:  # the loop took the others meanwhile, and this is the newest
                self._samples.appendleft(oldest)
                return
            self._in_bytes -= len(oldest[0]) + _OVERHEAD_BYTES


class Inbox:
    """Queue of samples, bounded by a QoS; it gives samples to `get` or messages to a callback, oldest first.

    While the awaitable of a callback runs, samples wait in the queue. The bridge belongs to the reader's loop.
    """

    def __init__(
        self,
        bridge: LoopBridge,
        qos: QoSProfile,
        *,
        decode: Callable[[Sample], Any],
        callback: Callback | None,
        calls: CallbackRunner,
    ) -> None:
        self.queue = SampleQueue(qos)
        self.calls = calls
        self.closed = False  #: Whether the inbox is closed, so that no sample will arrive any more.
        #: Function that is called on the loop with a publisher's GID and whether the publisher is alive.
        self.on_life: Callable[[bytes, bool], None] = nothing
        self._bridge = bridge
        self._callback = callback
        self._decoded_call = _after(decode, callback)
        self._waiters: deque[asyncio.Future[None]] = deque()
        self._running: asyncio.Task[Any] | None = None
        self._at_once = 0
        self._posted = False
        self._is_yielding = False

    def push_from_thread(self, samples: Iterable[Sample]) -> None:
        """Queue samples from a transport's thread; the bridge's next flush wakes the loop."""
        self.queue.push(samples)
        if not self._posted:
            self._posted = True
            self._bridge.post(self._wake)

    def push(self, sample: Sample) -> None:
        """Deliver a sample on the loop: at once if the callback is idle, otherwise through the queue."""
        if (
            self._callback is not None
            and self._running is None
            and not len(self.queue)
            and not self.closed
        ):
            # This repeats `CallbackRunner.run` in place because a further call per sample is slow with cold
            # caches.
            try:
                result = self._decoded_call(sample)
            except Exception as error:  # noqa: BLE001 - reported; one bad message must not stop the others
                self.calls.report(error)
                return
            if result is not None and inspect.isawaitable(result):
                self._running = self.calls.spawn(result, self._finished)
        else:
            self.queue.push((sample,))
            self._wake()

    async def get(self, what: str) -> Sample:
        """Return the oldest sample; wait for one if there is none.

        Raises:
            ClosedError: The subscription `what` is closed.
        """
        self._at_once += 1
        if self._at_once > _MAX_PER_WAKE:
            self._at_once = 0
            await asyncio.sleep(0)
        while (sample := self.queue.pop()) is None:
            if self.closed:
                raise ClosedError(what)
            self._at_once = 0
            await self._wait()
        return sample

    def close(self) -> None:
        """Drop queued samples, stop delivery and let waiting calls of `get` fail; to be called on the loop."""
        self.closed = True
        self.queue.clear()
        if self._bridge.loop.is_closed():
            return
        if self._running is not None:
            self._running.cancel()
        self._wake_waiters(all_=True)

    async def _wait(self) -> None:
        waiter = self._bridge.loop.create_future()
        self._waiters.append(waiter)
        try:
            await waiter
        except asyncio.CancelledError:
            # This call was woken and cancelled at once, so the sample goes to the next waiting call.
            if waiter.done() and not waiter.cancelled() and len(self.queue):
                self._wake_waiters()
            raise
        finally:
            if waiter in self._waiters:
                self._waiters.remove(waiter)

    def _wake(self) -> None:
        self._posted = False
        if self._callback is not None:
            self._deliver()
        else:
            self._wake_waiters()

    def _wake_waiters(self, *, all_: bool = False) -> None:
        ready = len(self.queue)
        while self._waiters and (all_ or ready > 0):
            waiter = self._waiters.popleft()
            if not waiter.done():
                waiter.set_result(None)
                ready -= 1

    def _deliver(self) -> None:
        if self._is_yielding:
            return
        loop = self._bridge.loop
        end_s = loop.time() + _MAX_BUSY_S
        for _ in range(_MAX_PER_WAKE):
            if self.closed or self._running is not None:
                return
            sample = self.queue.pop()
            if sample is None:
                return
            self._running = self.calls.run(self._decoded_call, sample, then=self._finished)
            if loop.time() > end_s:
                break
        self._is_yielding = True
        loop.call_soon(self._go_on)

    def _go_on(self) -> None:
        self._is_yielding = False
        self._deliver()

    def _finished(self) -> None:
        self._running = None
        self._deliver()


class ThreadInbox(Inbox):
    """Inbox that calls a plain callback in the transport's thread; later samples wait in the transport."""

    def __init__(self, bridge: LoopBridge, qos: QoSProfile, **options: Any) -> None:
        super().__init__(bridge, qos, **options)
        self._calling = threading.RLock()

    def push_from_thread(self, samples: Iterable[Sample]) -> None:
        """Call the callback with each sample, oldest first; `close` waits for a running call."""
        for sample in samples:
            with self._calling:
                self.push(sample)

    def push(self, sample: Sample) -> None:
        """Call the callback with a sample; the caller's `close` has to wait for its thread."""
        if self.closed:
            return
        try:
            self._decoded_call(sample)
        except Exception as error:  # noqa: BLE001 - reported; one bad message must not stop the others
            self._bridge.post(partial(self.calls.report, error))
            self._bridge.flush()

    def close(self) -> None:
        """Call the callback no more, and return when a running call has ended, after 5 s at most."""
        self.closed = True
        if self._calling.acquire(timeout=JOIN_S):
            self._calling.release()
        super().close()


def _after(decode: Callable[[Sample], Any], callback: Callback | None) -> Callable[[Sample], Any]:
    """Return one function that decodes a sample and calls the callback, because it runs for every message."""
    return decode if callback is None else lambda sample: callback(decode(sample))
