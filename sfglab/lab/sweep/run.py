"""A sweep: it runs a task for points and seeds, and returns the results in order.

Threads, processes and workers of a dask scheduler are executors of `concurrent.futures`, so that
they share one code path.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice, product
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.errors import MissingExtraError
from sfglab.lab.progress import progress_bar
from sfglab.lab.sweep.journal import (
    SweepError,
    code_digest,
    identity_of,
    open_journal,
    text_from_result,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from sfglab.lab.sweep.journal import Journal

_CONNECT_S = 10.0
_QUEUED = 2  # Jobs per worker: one runs, one waits, so that no worker is idle.


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Local workers of a sweep.

    If the environment variable ``SFGLAB_SCHEDULER`` is set, the workers of the dask scheduler at this
    address, ``tcp://host:port``, run the sweep instead.
    """

    #: Number of local workers; None: one for each core that this process may use.
    count: int | None = None
    #: Whether local workers are threads of this process instead of processes. Threads suit tasks in
    #: compiled code that releases Python's lock, such as `sfglab.rtps.run`: two threads are as fast
    #: as two processes there, and they start in 0.05 s, where processes need 2 s to start, import
    #: and end. An interrupted sweep waits for running tasks in threads, and kills processes.
    threads: bool = False


_LOCAL = Workers()


def sweep(
    task: Callable[[Any, int], object],
    points: Sequence[object],
    seeds: Sequence[int],
    *,
    journal: Path,
    workers: Workers = _LOCAL,
) -> list[Any]:
    """Run a task for every point with every seed; return results by point, then by seed.

    Results are bit-identical on all kinds of workers. The journal keeps finished results: after an
    interruption of any kind the same call runs only the missing ones. Delete the journal to run all
    again. The journal of another task, of other points or of another version of the code is copied,
    and begun again.

    Args:
        task: A function at the top of a module. It returns a row or a tuple of rows: dataclasses or
            dicts of bool, int, float and str. Its result depends on its arguments alone.
        points: Frozen dataclasses.
        seeds: Seeds.
        journal: Path of the journal. Progress shows its name.
        workers: Workers. Processes need a script that starts under ``if __name__ == "__main__"``.

    Returns:
        Rows as dicts by column, or tuples of them.

    Raises:
        SweepError: The task failed (the message has the point and the seed), a worker ended, or
            there are no workers. Or another process uses the journal.
        MissingExtraError: A scheduler is given, and the extra ``cluster`` is not installed.
    """
    pairs = list(product(range(len(points)), map(int, seeds)))
    with open_journal(journal, identity_of(task, points)) as log:
        jobs = [Job(i, points[i], seed) for i, seed in pairs if (i, seed) not in log.finished]
        if jobs:
            with connected(workers, len(jobs)) as (pool, slots):
                _run_jobs(pool, slots, task, jobs, log)
    return [log.finished[pair] for pair in pairs]


# --- Jobs -----------------------------------------------------------------------------------------


class Job(NamedTuple):
    """One call of a sweep's task, for one point and one seed."""

    number: int  #: Index of the point.
    point: object  #: The point.
    seed: int  #: The seed.


def run_job(task: Callable[..., object], code: str, job: Job) -> str:
    """Run a job on a worker, and return its result as JSON.

    Args:
        task: Task of the sweep.
        code: The sweep's `code_digest`.
        job: Point and seed.

    Raises:
        SweepError: The task failed, or the worker has another version of the code.
    """
    if code_digest() != code:
        raise SweepError(
            "sweep: a worker has another version of the code; install the same version"
        )
    try:
        return text_from_result(task(job.point, job.seed))
    except (Exception, SystemExit) as error:  # noqa: BLE001 - raised again, with the point
        # Another process may be unable to import the class of the error.
        failure = SweepError(
            f"sweep: the task failed at {job.point} with seed {job.seed}: "
            f"{type(error).__name__}: {error}"
        )
        failure.add_note(traceback.format_exc())
        raise failure from None


def _run_jobs(
    pool: Executor, slots: int, task: Callable[..., object], jobs: Sequence[Job], log: Journal
) -> None:
    code = code_digest()
    waiting = iter(jobs)
    under_way: dict[Future[str], Job] = {}
    events: SimpleQueue[Future[str] | None] = SimpleQueue()  # None is Ctrl-C.

    def submit() -> None:
        for job in islice(waiting, _QUEUED * slots - len(under_way)):
            future = pool.submit(run_job, task, code, job)
            under_way[future] = job
            future.add_done_callback(events.put)

    # Ctrl-C waits for its turn: a KeyboardInterrupt within an executor could leave a lock closed.
    with (
        progress_bar(len(jobs), log.path.stem) as advance,
        on_interrupt(lambda *_: events.put(None)),
    ):
        for _ in jobs:
            try:
                submit()
                future = events.get()
                if future is None:
                    raise KeyboardInterrupt  # noqa: TRY301 - it is not caught here
                text = future.result()
            except (SweepError, KeyboardInterrupt):
                _keep_finished(under_way, log)
                raise
            except Exception as lost:
                _keep_finished(under_way, log)
                raise SweepError(
                    f"sweep: a worker ended or could not load the task ({lost!r}); "
                    "run the sweep again to continue"
                ) from lost
            job = under_way.pop(future)
            log.add(job.number, job.seed, text)
            advance(f"seed {job.seed}")
        if not events.empty():
            raise KeyboardInterrupt


def _keep_finished(under_way: Mapping[Future[str], Job], log: Journal) -> None:
    """Write the results of finished jobs, so that a continued sweep does not run them again."""
    for future, job in under_way.items():
        if future.done() and not future.cancelled() and future.exception() is None:
            log.add(job.number, job.seed, future.result())


@contextmanager
def on_interrupt(handler: Any) -> Iterator[None]:
    """Set the handler of Ctrl-C for a while, except in other threads and where it is ignored."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


# --- Workers --------------------------------------------------------------------------------------


@contextmanager
def connected(workers: Workers, jobs: int) -> Iterator[tuple[Executor, int]]:
    """Connect to workers or start them; yield their executor and their number.

    At most one local worker starts per job. Local workers listen on no port, and end with the
    context.

    Raises:
        SweepError: There is no scheduler at the address, or it has no workers.
        MissingExtraError: The extra ``cluster`` is not installed.
    """
    address = os.environ.get("SFGLAB_SCHEDULER")
    if address:
        with _client(address) as client:
            slots = sum(client.nthreads().values())
            if not slots:
                raise SweepError(
                    f"workers: the scheduler at {address} has no workers; start some and try again"
                )
            yield client.get_executor(pure=False), slots
        return
    count = min(jobs, workers.count or len(os.sched_getaffinity(0)))
    pool = ThreadPoolExecutor(count) if workers.threads else _processes(count)
    try:
        yield pool, count
    except BaseException:
        if isinstance(pool, ProcessPoolExecutor):
            _kill(pool)
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _processes(count: int) -> ProcessPoolExecutor:
    """Return an executor with started processes."""
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, spawn, begin_worker)
    # Processes inherit this, so that Ctrl-C in a terminal reaches none before `begin_worker` runs.
    with on_interrupt(signal.SIG_IGN):
        for _ in range(count):
            pool.submit(code_digest)
    return pool


def _kill(pool: Any) -> None:
    """Kill the processes of an executor, which itself would wait for their tasks."""
    # A process may die while it writes a result into this pipe. The executor would wait for the
    # rest indefinitely if this process kept its own end for writing.
    pool._result_queue._writer.close()  # noqa: SLF001
    for process in list(pool._processes.values()):  # noqa: SLF001
        process.kill()


def begin_worker() -> None:
    """Ignore Ctrl-C, which the parent process handles, and end when the parent process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _client(address: str) -> Any:
    """Return a connected client of a dask scheduler."""
    try:
        from distributed import Client
    except ImportError as error:
        purpose = f"a sweep on the scheduler {address}"
        raise MissingExtraError("distributed", extra="cluster", purpose=purpose) from error
    try:
        return Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SweepError(
            f"SFGLAB_SCHEDULER: given {address!r}, where no scheduler responds ({error}); start or unset it"
        ) from error
