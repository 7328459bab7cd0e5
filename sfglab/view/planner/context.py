"""Objects that all parts of the editor's window share: viser, its server, the editor, and the queue of jobs.

One thread runs all jobs in order, because the editor is for one thread and serves many browsers. Callbacks of viser's
event loop submit jobs. Only this module imports viser, so that the others can be imported without it.
"""

from __future__ import annotations

import asyncio
import logging
import threading
from abc import ABC, abstractmethod
from collections import deque
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.errors import MissingExtraError, SfglabError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Hashable, Iterator

    from sfglab.spatial.scene.editor import Change, Editor
    from sfglab.view.planner.sending import Sender


_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_Job = tuple["Hashable", "Callable[[], object]"]
#: A timer, its job, and whether the next user's action does the job first.
_Held = tuple[asyncio.TimerHandle, "Callable[[], object]", bool]


class JobQueue:
    """A queue of jobs, and the thread that runs them in an event loop, which jobs may use for tasks.

    Args:
        on_error: Called in this thread with the error of a failed job.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._loop = asyncio.new_event_loop()
        self._on_error = on_error
        self._jobs: deque[_Job] = deque()
        self._held: dict[Hashable, _Held] = {}
        self._closed = False
        self._lock = threading.Lock()  # a function that is posted before the end is still run
        self._thread = threading.Thread(
            target=self._loop.run_forever, name="planner-jobs", daemon=True
        )
        self._thread.start()

    def submit(self, job: Callable[[], object], *, key: Hashable = None) -> None:
        """Submit a job; it runs after all waiting jobs of `later` with `settles`.

        The job replaces the last waiting job if both have the same key, such as two positions of a slider.
        """
        self._post(partial(self._add, key, job))

    def later(
        self, key: Hashable, job: Callable[[], object], *, delay_s: float, settles: bool = True
    ) -> None:
        """Submit a job that runs after a time without another job of its key, for example when a user stops typing.

        Args:
            key: Key of the job, which replaces a waiting job of this key.
            job: The job.
            delay_s: Time without a job of this key, s.
            settles: Whether `submit`, `call` and `close` run the job first.
        """
        self._post(partial(self._hold, key, job, delay_s, settles=settles))

    def waits(self, key: Hashable) -> bool:
        """Return whether a job of `later` with this key waits."""
        return key in self._held

    def call(self, job: Callable[[], _T]) -> _T:
        """Run a job for another thread, and return its result or raise its error.

        Raises:
            SfglabError: The queue is closed.
        """
        future: Future[_T] = Future()

        def run() -> None:
            try:
                future.set_result(job())
            except BaseException as error:  # noqa: BLE001  # raised by `result`
                future.set_exception(error)

        if not self._post(partial(self._add, None, run)):
            raise SfglabError("the scene editor is closed; open it again to edit")
        return future.result()

    def close(self, last: Callable[[], Awaitable[None]]) -> None:
        """Run the remaining jobs and the job `last`, and end the thread; further calls have no effect."""
        if self._post(partial(self._end, last), closes=True):
            self._thread.join()
            self._loop.close()

    def _post(self, step: Callable[[], object], *, closes: bool = False) -> bool:
        """Run a function in the thread; return False if the queue is closed."""
        with self._lock:
            if self._closed:
                return False
            self._closed = closes
            self._loop.call_soon_threadsafe(step)
        return True

    def _add(self, key: Hashable, job: Callable[[], object]) -> None:
        self._settle()
        if key is not None and self._jobs and self._jobs[-1][0] == key:
            self._jobs.pop()
        self._jobs.append((key, job))
        self._loop.call_soon(self._do_next)

    def _hold(
        self, key: Hashable, job: Callable[[], object], delay_s: float, *, settles: bool
    ) -> None:
        if key in self._held:
            self._held[key][0].cancel()
        timer = self._loop.call_later(delay_s, self._release, key)
        self._held[key] = (timer, job, settles)

    def _release(self, key: Hashable) -> None:
        timer, job, _ = self._held.pop(key)
        timer.cancel()
        self._jobs.append((None, job))
        self._loop.call_soon(self._do_next)

    def _settle(self) -> None:
        for key, (_, _, settles) in list(self._held.items()):
            if settles:
                self._release(key)

    def _end(self, last: Callable[[], Awaitable[None]]) -> None:
        self._settle()
        while self._jobs:
            self._do_next()
        ending = asyncio.ensure_future(last())
        ending.add_done_callback(lambda _: self._loop.stop())

    def _do_next(self) -> None:
        if not self._jobs:  # a job of the same key replaced one
            return
        _, job = self._jobs.popleft()
        try:
            job()
        except SfglabError as error:
            self._on_error(error)
        except Exception as error:  # noqa: BLE001 - one job must not end the others
            _log.exception("the scene editor failed to do something")
            self._on_error(error)


class Part(ABC):
    """A part of the window: it shows the editor's state, and submits the users' actions to the queue of jobs."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._editor = context.editor
        self._gui = context.server.gui

    @abstractmethod
    def show(self, change: Change) -> None:
        """Show the editor's state after a change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """Objects that all parts of the planner's page share."""

    viser: Any  #: The library viser.
    server: Any  #: Server of viser; every browser shows the nodes and widgets that are added to it.
    editor: Editor  #: Editor of the scene, which only the thread of the jobs uses.
    jobs: JobQueue  #: Queue of the jobs.
    sender: Sender  #: Sender of trajectories to action servers.

    def on(
        self,
        job: Callable[[Any], object],
        *,
        read: Callable[[Any], Any] = lambda _: None,
        key: Hashable = None,
    ) -> Callable[[Any], Awaitable[None]]:
        """Return a callback for viser that reads an event and submits a job; viser awaits callbacks in order."""

        async def called(event: Any) -> None:
            if event.client_id is not None:  # an assignment by the program has no client
                given = read(event)
                self.jobs.submit(lambda: job(given), key=key)

        return called


def viser() -> Any:
    """Return the package viser.

    Raises:
        MissingExtraError: viser is not installed.
    """
    try:
        return import_module("viser")
    except ImportError as error:
        raise MissingExtraError("viser", extra="view", purpose="the scene editor") from error


@contextmanager
def quiet() -> Iterator[None]:
    """Keep viser from printing its banner into the terminal."""
    console = import_module("rich").get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
