"""A subscription's incoming side on the loop: its queue, its waiting readers and its callback."""

from __future__ import annotations

import asyncio
import inspect
from collections import deque
from typing import TYPE_CHECKING, Any

from sfglab.bus.errors import ClosedError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.bus.api import Callback
    from sfglab.bus.bridge import LoopBridge
    from sfglab.bus.calls import Calls
    from sfglab.bus.queue import Sample, SampleQueue


# Whoever reads a flood gives the loop to others after so many samples.
_MAX_PER_WAKE = 32


class Inbox:
    """Queues samples from a transport and hands them to `get` or to a callback, oldest first.

    A callback that returns an awaitable gets the next sample when that has finished; what arrives
    meanwhile waits in the queue, which drops the oldest by its own bound.

    Args:
        bridge: Where the reading side lives.
        queue: The bounded queue.
        decode: What a callback is given for a sample.
        callback: Called for every sample; None to read by `get`.
        calls: Runs callbacks and what they return.
    """

    def __init__(
        self,
        bridge: LoopBridge,
        queue: SampleQueue,
        *,
        decode: Callable[[Sample], Any],
        callback: Callback | None,
        calls: Calls,
    ) -> None:
        self.queue = queue
        self._bridge = bridge
        self._callback = callback
        self._decoded_call = _after(decode, callback)
        self.calls = calls
        self._waiters: deque[asyncio.Future[None]] = deque()
        self._running: asyncio.Task[Any] | None = None
        self._at_once = 0
        self._posted = False
        self._closed = False

    @property
    def closed(self) -> bool:
        """Whether nothing will arrive any more."""
        return self._closed

    def push_from_thread(self, samples: Iterable[Sample]) -> None:
        """Queue samples from a transport's thread; the bridge's next flush wakes the loop."""
        self.queue.push(samples)
        if not self._posted:
            self._posted = True
            self._bridge.post(self._wake)

    def push(self, sample: Sample) -> None:
        """Deliver a sample on the loop itself, at once if a callback is free for it."""
        if self._callback is not None and self._running is None and not len(self.queue) and not self._closed:
            # As `Calls.run`, but in place: it happens for every frame, in a process with cold caches.
            try:
                result = self._decoded_call(sample)
            except Exception as error:  # noqa: BLE001 - reported; one bad message must not end the others
                self.calls.report(error)
                return
            if result is not None and inspect.isawaitable(result):
                self._running = self.calls.spawn(result, self._finished)
        else:
            self.queue.push((sample,))
            self._wake()

    async def get(self, what: str) -> Sample:
        """Return the oldest sample, waiting for one.

        Raises:
            ClosedError: The subscription `what` is closed.
        """
        self._at_once += 1
        if self._at_once > _MAX_PER_WAKE:
            self._at_once = 0
            await asyncio.sleep(0)
        while (sample := self.queue.pop()) is None:
            if self._closed:
                raise ClosedError(what)
            self._at_once = 0
            await self._wait()
        return sample

    def close(self) -> None:
        """Forget what is queued, deliver nothing more and let those who wait fail; on the loop."""
        self._closed = True
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
            # Woken and cancelled at once: the sample is for the next one in line.
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
        for _ in range(_MAX_PER_WAKE):
            if self._closed or self._running is not None:
                return
            sample = self.queue.pop()
            if sample is None:
                return
            self._call(sample)
        self._bridge.loop.call_soon(self._deliver)

    def _call(self, sample: Sample) -> None:
        self._running = self.calls.run(self._decoded_call, sample, then=self._finished)

    def _finished(self) -> None:
        self._running = None
        self._deliver()


def _after(decode: Callable[[Sample], Any], callback: Callback | None) -> Callable[[Sample], Any]:
    """Return what is done with a sample: one function, since it is called for every message."""
    return decode if callback is None else lambda sample: callback(decode(sample))
