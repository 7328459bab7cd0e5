"""Runs the users' callbacks: plain or async, tracked, and with their failures reported instead of spread."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import Awaitable, Callable
from typing import Any

_log = logging.getLogger("sfglab.bus")

OnError = Callable[[BaseException, str], None]


class Calls:
    """The callbacks of one endpoint or timer.

    Args:
        tasks: Where running async callbacks are kept, shared with the node that ends them.
        where: What the callback belongs to, e.g. "subscription '/chatter'".
        on_error: Called with an exception and `where`; None logs it.

    Attributes:
        last_error: The latest exception of a callback, None if there was none.
    """

    def __init__(self, tasks: set[asyncio.Task[Any]], where: str, on_error: OnError | None) -> None:
        self.last_error: BaseException | None = None
        self._tasks = tasks
        self._where = where
        self._on_error = on_error

    def run(
        self,
        callback: Callable[..., Awaitable[Any] | Any],
        *arguments: Any,
        then: Callable[[], None] | None = None,
    ) -> asyncio.Task[Any] | None:
        """Call a callback.

        Args:
            callback: Plain, or returning an awaitable.
            arguments: What it is given.
            then: Called when an awaitable has ended, unless it was cancelled.

        Returns:
            The task of an awaitable, None when the callback has ended.
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
