"""A node's loop and a thread beside it: posted functions, readable descriptors, waits and users' callbacks."""

from __future__ import annotations

import asyncio
import inspect
import logging
import os
import select
import threading
from collections import deque
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

_log = logging.getLogger("sfglab.bus")

#: Longest wait for a thread, s: the thread may be in a callback that waits for the caller.
JOIN_S = 5.0
_READABLE_AT_ONCE = 16


class LoopBridge:
    """Bridge over which other threads run functions on a loop; it wakes the loop once per batch."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self._posted: deque[Callable[[], None]] = deque()
        self._scheduled = False
        self._lock = threading.Lock()

    def post(self, function: Callable[[], None]) -> None:
        """Let the next `flush` run a function on the loop; thread-safe, and ignored after the loop's end."""
        with self._lock:
            self._posted.append(function)

    def flush(self) -> None:
        """Wake the loop if functions were posted since the last batch."""
        with self._lock:
            if self._scheduled or not self._posted:
                return
            self._scheduled = True
        try:
            self.loop.call_soon_threadsafe(self._run)
        except RuntimeError:
            # An interrupted script closes its loop without closing its node.
            self._posted.clear()

    def watch(self, fd: int, function: Callable[[], None]) -> None:
        """Call a function on the loop whenever a descriptor is readable."""
        self.loop.add_reader(fd, function)

    def unwatch(self, fd: int) -> None:
        """End `watch`; harmless for an unwatched descriptor and after the loop's end."""
        if not self.loop.is_closed():
            self.loop.remove_reader(fd)

    def run_in_thread(self, function: Callable[[], None]) -> None:
        """Call a function where watched descriptors are handled, here at once, and return when it is done."""
        function()

    def run_on_loop(self, function: Callable[[], None]) -> None:
        """Call a function on the loop; called where watched descriptors are handled, which here is the loop."""
        function()

    def _run(self) -> None:
        with self._lock:
            functions = list(self._posted)
            self._posted.clear()
            self._scheduled = False
        for function in functions:
            call_logged(function)


class WatchThread:
    """Thread that watches descriptors as a `LoopBridge` does; it refers to the bridge and to no node."""

    def __init__(self, bridge: LoopBridge, name: str) -> None:
        self.loop = bridge.loop
        self._bridge = bridge
        self._poll = select.epoll()
        self._bell = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self._functions: dict[int, Callable[[], None]] = {}
        self._orders: deque[Callable[[], None]] = deque()
        self._is_stopping = False
        self.watch(self._bell, self._run_orders)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def watch(self, fd: int, function: Callable[[], None]) -> None:
        """Call a function in the thread whenever a descriptor is readable."""
        self._functions[fd] = function
        self._poll.register(fd, select.EPOLLIN)

    def unwatch(self, fd: int) -> None:
        """End `watch`, called in the thread only; harmless for an unwatched descriptor."""
        if self._functions.pop(fd, None) is not None:
            self._poll.unregister(fd)

    def run_in_thread(self, function: Callable[[], None]) -> None:
        """Call a function in the thread, and return when it is done, after 5 s at most."""
        if self._thread is threading.current_thread() or not self._thread.is_alive():
            function()
            return
        done = threading.Event()
        self._orders += [function, done.set]
        os.eventfd_write(self._bell, 1)
        done.wait(JOIN_S)

    def run_on_loop(self, function: Callable[[], None]) -> None:
        """Let the event loop call a function as soon as it can, and return without waiting for the call."""
        self._bridge.post(function)
        self._bridge.flush()

    def stop(self) -> None:
        """Stop the thread, and return when it has ended, after 5 s at most."""
        self.run_in_thread(self._end)
        if self._thread is not threading.current_thread():
            self._thread.join(JOIN_S)

    def _end(self) -> None:
        self._is_stopping = True

    def _run_orders(self) -> None:
        os.eventfd_read(self._bell)
        while self._orders:
            self._orders.popleft()()

    def _run(self) -> None:
        poll, functions = self._poll.poll, self._functions
        while not self._is_stopping:
            for fd, _ in poll(-1, _READABLE_AT_ONCE):
                if fd in functions:
                    call_logged(functions[fd])
        self._poll.close()
        os.close(self._bell)


def nothing(*_: object) -> None:
    """Accept any arguments and do nothing; a placeholder for callbacks."""


def call_logged(function: Callable[[], None]) -> None:
    """Call a function; an exception is logged instead of raised."""
    try:
        function()
    except Exception:  # noqa: BLE001 - logged; one failed event must not stop the others of its batch
        _log.exception("handling a transport's event failed")


class Signal:
    """Signal that lets waiting coroutines of one loop check their predicates after a change of state."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._waiters: dict[
            asyncio.Future[None], None
        ] = {}  # a dict, so that they are woken in order of arrival

    def notify(self) -> None:
        """Let all waiting coroutines check their predicates again; to be called on the loop."""
        for waiter in self._waiters:
            if not waiter.done():
                waiter.set_result(None)

    async def wait(self) -> None:
        """Wait until the next call of `notify`."""
        waiter = self._loop.create_future()
        self._waiters[waiter] = None
        try:
            await waiter
        finally:
            self._waiters.pop(waiter, None)

    async def wait_until(self, predicate: Callable[[], bool], timeout_s: float | None) -> bool:
        """Return True once the predicate holds, False if it does not within `timeout_s`, None for no limit."""
        try:
            async with asyncio.timeout(timeout_s):
                while not predicate():
                    await self.wait()
        except TimeoutError:
            return predicate()
        return True


class CallbackRunner:
    """Runner of the plain or async callbacks of one endpoint or timer; it tracks tasks and logs failures.

    Running tasks are kept in `tasks`. `where` names the owner of the callback, such as
    "subscription '/chatter'".
    """

    def __init__(self, tasks: set[asyncio.Task[Any]], where: str) -> None:
        self._tasks = tasks
        self._where = where

    def run(
        self,
        callback: Callable[..., Awaitable[Any] | Any],
        *arguments: Any,
        then: Callable[[], None] | None = None,
    ) -> asyncio.Task[Any] | None:
        """Call a callback; return a task for its awaitable, whose end calls `then`, or None without one."""
        try:
            result = callback(*arguments)
        except Exception as error:  # noqa: BLE001 - reported; one bad callback must not stop the others
            self.report(error)
            return None
        return (
            None if result is None or not inspect.isawaitable(result) else self.spawn(result, then)
        )

    def spawn(
        self, awaitable: Awaitable[Any], then: Callable[[], None] | None = None
    ) -> asyncio.Task[Any]:
        """Run an awaitable as a tracked task; see `run`."""
        task = asyncio.ensure_future(awaited(awaitable))
        self._tasks.add(task)
        task.add_done_callback(lambda ended: self._ended(ended, then))
        return task

    def report(self, error: BaseException) -> None:
        """Log the exception of a callback, with the name of its endpoint and the traceback."""
        _log.error("callback of %s failed", self._where, exc_info=error)

    def _ended(self, task: asyncio.Task[Any], then: Callable[[], None] | None) -> None:
        self._tasks.discard(task)
        if task.cancelled():
            return
        if (error := task.exception()) is not None:
            self.report(error)
        if then is not None:
            then()


async def awaited(value: Any) -> Any:
    """Return the result of a plain callback, or the awaited result of an async one."""
    return await value if inspect.isawaitable(value) else value
