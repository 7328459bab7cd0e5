"""The context of every part of the editor's window: viser, its server, the editor, and the queue of jobs.

One thread does all jobs in order, so that an editor of one thread serves many browsers. Callbacks of viser's
event loop, a timer and the bus leave jobs. Only this module imports viser, so that the others can be imported
without it.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
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
#: Time when a job is due, the job, and whether the next user's action does it first.
_Held = tuple[float, "Callable[[], object]", bool]


class JobQueue:
    """A queue of jobs and the thread that does them; `refused` gets each error, on this thread."""

    def __init__(self, refused: Callable[[Exception], None]) -> None:
        self._refused = refused
        self._wake = threading.Condition()
        self._jobs: deque[_Job] = deque()
        self._later: dict[Hashable, _Held] = {}
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="planner-jobs", daemon=True)
        self._thread.start()

    def submit(
        self, job: Callable[[], object], *, key: Hashable = None, settle: bool = True
    ) -> None:
        """Leave a job; it replaces the last waiting one if both have the same key, as positions of a slider.

        Args:
            job: The job.
            key: Key of the job; None: it replaces none.
            settle: Whether jobs of `later` are done before, as before an undo.
        """
        with self._wake:
            if self._closed:
                return
            if settle:
                self._settle()
            if key is not None and self._jobs and self._jobs[-1][0] == key:
                self._jobs.pop()
            self._jobs.append((key, job))
            self._wake.notify()

    def later(
        self, key: Hashable, job: Callable[[], object], *, delay_s: float, settles: bool = True
    ) -> None:
        """Leave a job that waits until none of its key was left for a while, as while a user types.

        Args:
            key: Key of the job, which replaces a waiting one of its key.
            job: The job.
            delay_s: Time without a job of this key, s.
            settles: Whether `submit` with `settle`, `call` and `close` do it first.
        """
        with self._wake:
            if not self._closed:
                self._later[key] = (time.monotonic() + delay_s, job, settles)
                self._wake.notify()

    def waits(self, key: Hashable) -> bool:
        """Return whether a job of `later` waits."""
        with self._wake:
            return key in self._later

    def call(self, job: Callable[[], _T]) -> _T:
        """Do a job from another thread and return its result; SfglabError if the queue is closed."""
        future: Future[_T] = Future()

        def run() -> None:
            try:
                future.set_result(job())
            except BaseException as error:  # noqa: BLE001  # raised by `result`
                future.set_exception(error)

        with self._wake:
            if self._closed:
                raise SfglabError("the scene editor is closed: no edit is taken any more")
            self._settle()
            self._jobs.append((None, run))
            self._wake.notify()
        return future.result()

    def close(self) -> None:
        """Do the remaining jobs and end; further calls have no effect."""
        with self._wake:
            self._settle()
            self._closed = True
            self._wake.notify()
        self._thread.join()

    def _settle(self) -> None:
        for key, (_, job, settles) in list(self._later.items()):
            if settles:
                self._jobs.append((None, job))
                del self._later[key]

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except SfglabError as error:
                self._refused(error)
            except Exception as error:  # noqa: BLE001 - one job must not end the others
                _log.exception("the scene editor failed to do something")
                self._refused(error)

    def _next(self) -> Callable[[], object] | None:
        with self._wake:
            while not self._jobs:
                if self._closed:
                    return None
                now_s = time.monotonic()
                for key in [key for key, held in self._later.items() if held[0] <= now_s]:
                    self._jobs.append((None, self._later.pop(key)[1]))
                if not self._jobs:
                    due_s = min((held[0] for held in self._later.values()), default=None)
                    self._wake.wait(None if due_s is None else due_s - now_s)
            return self._jobs.popleft()[1]


class Part(ABC):
    """A part of the window: it shows the editor's state, and leaves the users' actions in the queue of jobs."""

    def __init__(self, context: Context, container: Any) -> None:
        self._context = context
        self._container = container

    @abstractmethod
    def show(self, change: Change) -> None:
        """Show a change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Context:
    """Objects that all parts share."""

    viser: Any  #: The library.
    server: Any  #: Its server; what is added to it, every browser shows.
    editor: Editor  #: The scene in work; touched on the jobs's thread only.
    jobs: JobQueue  #: The thread.
    sender: Sender  #: Sender of trajectories to action servers.

    def on(
        self,
        job: Callable[[Any], object],
        *,
        read: Callable[[Any], Any] = lambda _: None,
        key: Hashable = None,
    ) -> Callable[[Any], Awaitable[None]]:
        """Return a coroutine for viser, which awaits those in order, that reads an event and leaves a job."""

        async def called(event: Any) -> None:
            if event.client_id is not None:  # else it is our own assignment
                given = read(event)
                self.jobs.submit(lambda: job(given), key=key)

        return called


def viser() -> Any:
    """Return viser; MissingExtraError where it is not installed."""
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
