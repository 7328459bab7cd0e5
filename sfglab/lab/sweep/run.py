"""A sweep: hands out what is missing in batches, writes down what comes back, returns all of it in order.

Batches take a good tenth of a second. A failure is a value, because an exception may not survive its journey.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections import deque
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.lab.progress import progress_bar
from sfglab.lab.sweep.journal import (
    Finished,
    Journal,
    SweepError,
    code_digest,
    identity_of,
    result_from_text,
    text_from_result,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Job:
    """One point and seed to run."""

    index: int  #: Of the point.
    point: object  #: The point.
    seed: int  #: The seed.


@dataclass(frozen=True, slots=True)
class Failure:
    """A job that failed."""

    job: Job | None  #: Which; None: the worker's code is another version, and nothing was run.
    reason: str  #: Type and text of the error.
    trace: str = ""  #: Where it was raised.
    interrupt: bool = False  #: Whether it was an order to stop (Ctrl-C) and no error.


@dataclass(frozen=True, slots=True)
class Done:
    """What became of a batch."""

    finished: tuple[Finished, ...]  #: Results, in the jobs' order.
    busy_s: float  #: How long it took.
    failure: Failure | None = None  #: The first failure, which ended it; None: all are finished.


def run_batch(task: Callable[..., object], code: str, jobs: Sequence[Job]) -> Done:
    """Run a task's jobs, one after the other, with the `code_digest` of who started the sweep."""
    if (own := code_digest()) != code:
        return Done((), 0.0, Failure(None, f"version {own}, the sweep's is {code}"))
    start_s = time.perf_counter()
    finished: list[Finished] = []
    failure = None
    for job in jobs:
        try:
            result = task(job.point, job.seed)
            finished.append(Finished(job.index, job.seed, text_from_result(result)))
        except (Exception, KeyboardInterrupt, SystemExit) as error:  # noqa: BLE001 - told to who started the sweep
            stop = isinstance(error, KeyboardInterrupt)
            failure = Failure(
                job, f"{type(error).__name__}: {error}", traceback.format_exc(), interrupt=stop
            )
            break
    return Done(tuple(finished), time.perf_counter() - start_s, failure)


#: A scheduler's address, for programs that do not name one.
SCHEDULER_VARIABLE = "SFGLAB_SCHEDULER"

_CONNECT_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Who does the work."""

    #: How many local workers; None: as many as this process may use cores.
    count: int | None = None
    #: Whether they are threads of this process instead of processes of their own. For tasks that spend their
    #: time in compiled code that releases the lock, such as `sfglab.rtps.run`: two threads are as fast as two
    #: processes there, and start in 0.05 s where processes need 0.7 s, their first imports another second, and
    #: their end 0.6 s. Python code in threads takes turns. An interrupted sweep waits for the tasks that its
    #: threads are at; processes are ended at once.
    threads: bool = False
    #: Address of a running scheduler, ``tcp://host:port``, instead of local workers; None: what the environment
    #: variable ``SFGLAB_SCHEDULER`` says, if anything.
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.count is not None and self.count < 1:
            raise SweepError(f"workers: count: given {self.count}, allowed are 1 and more")


@contextmanager
def connected(workers: Workers) -> Iterator[tuple[Executor, int]]:
    """Connect to workers, start them if need be, by pipes that only they inherit, and leave nothing behind.

    Yields who takes tasks, and how many at a time. Raises `SweepError` if no scheduler or worker is there.
    """
    address = workers.scheduler or os.environ.get(SCHEDULER_VARIABLE)
    if address:
        with _cluster(address) as client:
            yield client.get_executor(pure=False), sum(client.nthreads().values())
        return
    count = workers.count or len(os.sched_getaffinity(0))
    spawn = multiprocessing.get_context("spawn")
    pool = (
        ThreadPoolExecutor(count)
        if workers.threads
        else ProcessPoolExecutor(count, spawn, begin_worker)
    )
    try:
        with _hearing(
            signal.SIG_IGN
        ):  # inherited by processes: the sweep ends them, not the terminal
            wait([pool.submit(code_digest) for _ in range(count)])
        yield pool, count
    except BaseException:
        for process in tuple(getattr(pool, "_processes", {}).values()):
            process.kill()  # in the middle of what it does
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def begin_worker() -> None:
    """Leave Ctrl-C to who started the sweep, and end with that process, however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _cluster(address: str) -> Iterator[Any]:
    from distributed import Client

    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SweepError(
            f"workers: scheduler: given {address!r}, where none answers ({error})"
        ) from error
    with client:
        if not client.nthreads():
            raise SweepError(
                f"workers: the scheduler at {address} has no workers; start some and try again"
            )
        yield client


@contextmanager
def _hearing(handler: Any) -> Iterator[Any]:
    """Handle Ctrl-C otherwise for a while, where signals are ours to set; yields what handled it before."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield before
        return
    signal.signal(signal.SIGINT, handler)
    try:
        yield before
    finally:
        signal.signal(signal.SIGINT, before)


P = TypeVar("P")
R = TypeVar("R")

_BATCH_S = 0.15
_AHEAD = 2  # batches at a worker: one that runs, one that waits, so that it never does
_LOCAL = Workers()


def sweep(
    task: Callable[[P, int], R],
    points: Sequence[P],
    seeds: Sequence[int],
    *,
    journal: Path,
    workers: Workers = _LOCAL,
) -> list[R]:
    """Run a task for every point with every seed; return results by point, then by seed, the same to the bit.

    What is finished stands in the journal: after an interruption, whatever its kind, the same call runs only
    what is missing; delete it to run all again. A journal of another task, of other points or of another
    version of the code is set aside (renamed).

    Args:
        task: A function at the top of a module; returns a row or a tuple of rows: flat dataclasses of bool,
            int, float and str. It depends on its arguments alone.
        points: Frozen dataclasses, all different.
        seeds: All different.
        journal: The file; shown in progress by its name.
        workers: Who does the work; processes need a script that starts under ``if __name__ == "__main__"``.

    Raises:
        SweepError: A task failed (the message says with which point and seed), or there are no workers.
        JournalError: The journal cannot be used.
    """
    seeds = [int(seed) for seed in seeds]
    for name, given in (("points", points), ("seeds", seeds)):
        if (differ := len({repr(one) for one in given})) != len(given):
            raise SweepError(
                f"{name}: given {len(given)}, of which only {differ} differ; give each once"
            )
    with Journal(journal, identity_of(task, points)) as log:
        pairs = [(i, seed) for i in range(len(points)) for seed in seeds]
        missing = [Job(i, points[i], seed) for i, seed in pairs if (i, seed) not in log.finished]
        if missing:
            with connected(workers) as (pool, slots):
                _hand_out(pool, slots, task, missing, log)
        return [result_from_text(log.finished[pair]) for pair in pairs]


def _hand_out(pool: Executor, slots: int, task: Any, missing: Sequence[Job], log: Journal) -> None:
    waiting, under_way, code = deque(missing), set[Future[Done]](), code_digest()
    ended = SimpleQueue[Future[Done] | None]()

    def submit(most: int) -> None:
        share = min(most, max(1, len(waiting) // (2 * slots)), len(waiting))
        if share:
            jobs = [waiting.popleft() for _ in range(share)]
            future = pool.submit(run_batch, task, code, jobs)
            under_way.add(future)
            future.add_done_callback(ended.put)

    # Ctrl-C waits for its turn: raised in the middle of a pool's code, it would leave locks that nobody opens.
    with (
        progress_bar(len(missing), log.name) as advance,
        _hearing(lambda *_: ended.put(None)) as interrupt,
    ):
        for _ in range(_AHEAD * slots):
            submit(1)
        size = 1
        while under_way or not ended.empty():
            future = ended.get()
            if future is None:
                interrupt(signal.SIGINT, None)
                continue
            under_way.discard(future)
            done = _done(future)
            for finished in done.finished:
                log.add(finished)
                advance(f"seed {finished.seed}")
            if done.failure:
                _raise(done.failure)
            size = _next_size(size, done)
            submit(size)


def _next_size(size: int, done: Done) -> int:
    """Return how many jobs take as long as a batch should, at most twice as many as before."""
    return max(1, min(2 * size, round(_BATCH_S * len(done.finished) / max(done.busy_s, 1e-9))))


def _done(future: Future[Done]) -> Done:
    """Return a batch's result; the worker itself may be lost."""
    try:
        return future.result()
    except Exception as error:
        raise SweepError(
            f"sweep: a worker was lost or could not load the task ({error!r})"
        ) from error


def _raise(failure: Failure) -> None:
    if failure.interrupt:
        raise KeyboardInterrupt
    if failure.job is None:
        raise SweepError(
            f"sweep: a worker has another version of the code: {failure.reason}; install the same"
        )
    error = SweepError(
        f"sweep: the task failed at {failure.job.point} with seed {failure.job.seed}: {failure.reason}",
        point=failure.job.point,
        seed=failure.job.seed,
    )
    error.add_note(failure.trace)
    raise error
