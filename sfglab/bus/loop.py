"""A node's loop: posts of other threads, waits for a fact to become true, and the users' callbacks."""

from __future__ import annotations

import asyncio
import inspect
import logging
import threading
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any

_log = logging.getLogger("sfglab.bus")

OnError = Callable[[BaseException, str], None]


class LoopBridge:
    """Runs functions on a loop for other threads, waking the loop once per batch."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self._posted: deque[Callable[[], None]] = deque()
        self._scheduled = False
        self._lock = threading.Lock()

    def post(self, function: Callable[[], None]) -> None:
        """Run a function on the loop soon; safe from every thread, ignored when the loop has ended."""
        with self._lock:
            self._posted.append(function)

    def flush(self) -> None:
        """Wake the loop if anything was posted since it last ran."""
        with self._lock:
            if self._scheduled or not self._posted:
                return
            self._scheduled = True
        try:
            self.loop.call_soon_threadsafe(self._run)
        except RuntimeError:
            # The loop was closed without closing the node, as an interrupted script does.
            self._posted.clear()

    def watch(self, fd: int, function: Callable[[], None]) -> None:
        """Call a function on the loop whenever a descriptor is readable."""
        self.loop.add_reader(fd, function)

    def unwatch(self, fd: int) -> None:
        """End `watch`; harmless for an unwatched descriptor and after the loop's end."""
        if not self.loop.is_closed():
            self.loop.remove_reader(fd)

    def _run(self) -> None:
        with self._lock:
            functions = list(self._posted)
            self._posted.clear()
            self._scheduled = False
        for function in functions:
            try:
                function()
            except Exception:  # noqa: BLE001 - logged; one event must not cost the others of its batch
                _log.exception("handling a transport's event failed")


class Signal:
    """Wakes coroutines of one loop that wait for a predicate, whenever the state it reads may have changed."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._waiters: dict[asyncio.Future[None], None] = {}  # woken in the order in which they came

    def notify(self) -> None:
        """Let all waiters look again; to be called on the loop."""
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(None)

    async def wait(self) -> None:
        """Return at the next notification."""
        waiter = self._loop.create_future()
        self._waiters[waiter] = None
        try:
            await waiter
        finally:
            self._waiters.pop(waiter, None)

    async def wait_until(self, predicate: Callable[[], bool], timeout_s: float | None) -> bool:
        """Return True once the predicate holds, False when it did not within `timeout_s`; None: no limit."""
        try:
            async with asyncio.timeout(timeout_s):
                while not predicate():
                    await self.wait()
        except TimeoutError:
            return predicate()
        return True


class Calls:
    """The callbacks of one endpoint or timer: plain or async, tracked, and with failures reported, not spread.

    Args:
        tasks: Where running async callbacks are kept, shared with the node that ends them.
        where: What the callback belongs to, e.g. "subscription '/chatter'".
        on_error: Called with an exception and `where`; None logs it.
    """

    def __init__(self, tasks: set[asyncio.Task[Any]], where: str, on_error: OnError | None) -> None:
        self.last_error: BaseException | None = None  #: The latest exception of a callback.
        self._tasks = tasks
        self._where = where
        self._on_error = on_error

    def run(
        self,
        callback: Callable[..., Awaitable[Any] | Any],
        *arguments: Any,
        then: Callable[[], None] | None = None,
    ) -> asyncio.Task[Any] | None:
        """Call a callback; return the task of an awaitable that it returns, None when it has ended.

        When an awaitable has ended, unless it was cancelled, `then` is called.
        """
        try:
            result = callback(*arguments)
        except Exception as error:  # noqa: BLE001 - reported; one bad callback must not end the others
            self.report(error)
            return None
        return None if result is None or not inspect.isawaitable(result) else self.spawn(result, then)

    def spawn(self, awaitable: Awaitable[Any], then: Callable[[], None] | None = None) -> asyncio.Task[Any]:
        """Run an awaitable as a tracked task; see `run`."""
        task = asyncio.ensure_future(_awaited(awaitable))
        self._tasks.add(task)
        task.add_done_callback(lambda ended: self._ended(ended, then))
        return task

    def report(self, error: BaseException) -> None:
        """Tell the node's owner about a failure."""
        self.last_error = error
        if self._on_error is not None:
            self._on_error(error, self._where)
        else:
            _log.error("callback of %s failed", self._where, exc_info=error)

    def _ended(self, task: asyncio.Task[Any], then: Callable[[], None] | None) -> None:
        self._tasks.discard(task)
        if task.cancelled():
            return
        if (error := task.exception()) is not None:
            self.report(error)
        if then is not None:
            then()


async def _awaited(awaitable: Awaitable[Any]) -> Any:
    return await awaitable
