"""A sweep: hands out what is missing in batches, writes down what comes back, returns all of it in order.

Knows neither what is swept nor how work travels. Batches grow until one takes a good tenth of a second, so
that short tasks do not drown in a scheduler's overhead, and shrink towards the end, so that no worker waits for
another.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.lab.progress import progress_bar
from sfglab.lab.sweep.batch import Done, Failure, Job, run_batch
from sfglab.lab.sweep.errors import SweepError
from sfglab.lab.sweep.identity import code_digest, identity_of
from sfglab.lab.sweep.journal import Journal
from sfglab.lab.sweep.rows import result_from_text
from sfglab.lab.sweep.workers import Workers, connected

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path


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
    """Run a task for every point with every seed.

    What is finished stands in the journal: after an interruption, whatever its kind, the same call runs only
    what is missing. A finished sweep's journal answers for it; delete the journal to run it again. A journal
    of another task, of other points or of another version of the code is set aside (renamed). A script that
    uses processes must start under ``if __name__ == "__main__"``, as with `multiprocessing`.

    Args:
        task: A function at the top of a module; returns a row or a tuple of rows: flat dataclasses of bool,
            int, float and str. It depends on its arguments alone.
        points: Frozen dataclasses, all different.
        seeds: All different.
        journal: The file; shown in progress by its name.
        workers: Who does the work.

    Returns:
        Results by point, then by seed, the same to the bit wherever they ran.

    Raises:
        SweepError: A task failed (the message says with which point and seed), or there are no workers.
        JournalError: The journal cannot be used.
    """
    seeds = [int(seed) for seed in seeds]
    for name, given in (("points", points), ("seeds", seeds)):
        if (differ := len({repr(one) for one in given})) != len(given):
            raise SweepError(f"{name}: given {len(given)}, of which only {differ} differ; give each once")
    identity = identity_of(task, points)
    with Journal(journal, identity) as log:
        pairs = [(i, seed) for i in range(len(points)) for seed in seeds]
        missing = [Job(i, points[i], seed) for i, seed in pairs if (i, seed) not in log.finished]
        if missing:
            with connected(workers, journal.with_name(f".{journal.name}.workers")) as client:
                _hand_out(client, task, missing, log)
        return [result_from_text(log.finished[pair]) for pair in pairs]


def _hand_out(client: Any, task: Any, missing: Sequence[Job], log: Journal) -> None:
    from distributed import as_completed

    slots = sum(client.nthreads().values())
    waiting, under_way, code = deque(missing), as_completed(loop=client.loop), code_digest()

    def submit(most: int) -> None:
        share = min(most, max(1, len(waiting) // (2 * slots)), len(waiting))
        if share:
            jobs = [waiting.popleft() for _ in range(share)]
            under_way.add(client.submit(run_batch, task, code, jobs, pure=False))

    with progress_bar(len(missing), log.name) as advance:
        for _ in range(_AHEAD * slots):
            submit(1)
        size = 1
        for future in under_way:
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


def _done(future: Any) -> Done:
    """Return a batch's result; the worker itself may be lost."""
    try:
        done: Done = future.result()
    except Exception as error:
        raise SweepError(f"sweep: a worker was lost or could not load the task ({error})") from error
    return done


def _raise(failure: Failure) -> None:
    if failure.interrupt:
        raise KeyboardInterrupt
    if failure.job is None:
        raise SweepError(f"sweep: a worker has another version of the code: {failure.reason}; install the same")
    error = SweepError(
        f"sweep: the task failed at {failure.job.point} with seed {failure.job.seed}: {failure.reason}",
        point=failure.job.point,
        seed=failure.job.seed,
    )
    error.add_note(failure.trace)
    raise error
