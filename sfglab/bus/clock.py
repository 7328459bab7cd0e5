"""The live clock and timers on it."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sfglab.bus.calls import Calls


class SystemClock:
    """The host's clock, as ROS 2 stamps messages with it."""

    def now_ns(self) -> int:
        """Return the current time, in nanoseconds since the Unix epoch."""
        return time.time_ns()

    async def sleep_for(self, duration_s: float) -> None:
        """Return after `duration_s` seconds."""
        await asyncio.sleep(duration_s)


class Timer:
    """Calls a callback every `period_s` seconds, without drift; what was missed is skipped.

    An async callback that is still running when its next turn comes loses that turn.

    Args:
        period_s: The period in seconds, above 0.
        callback: Plain or async, without arguments.
        calls: Runs the callback.
    """

    def __init__(self, period_s: float, callback: Callable[[], Awaitable[None] | None], calls: Calls) -> None:
        if not period_s > 0:
            raise ValueError(f"timer period: given {period_s} s, allowed are positive seconds")
        self._loop = asyncio.get_running_loop()
        self._period_s = period_s
        self._callback = callback
        self._calls = calls
        self._next_s = self._loop.time() + period_s
        self._running: asyncio.Task[Any] | None = None
        self._handle = self._loop.call_at(self._next_s, self._tick)

    def cancel(self) -> None:
        """Stop the timer and a callback that runs; again is harmless."""
        if self._loop.is_closed():
            return
        self._handle.cancel()
        if self._running is not None:
            self._running.cancel()

    close = cancel

    def _tick(self) -> None:
        missed = max(0, int((self._loop.time() - self._next_s) / self._period_s))
        self._next_s += (1 + missed) * self._period_s
        self._handle = self._loop.call_at(self._next_s, self._tick)
        if self._running is None or self._running.done():
            self._running = self._calls.run(self._callback)
