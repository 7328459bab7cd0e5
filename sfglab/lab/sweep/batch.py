"""What a worker does with a share of a sweep: run it, and hand back text and times.

Knows nothing of schedulers. A failure is a value like any other, because an exception of the task's making may
not survive the journey between processes.
"""

from __future__ import annotations

import time
import traceback
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.lab.sweep.identity import code_digest
from sfglab.lab.sweep.journal import Finished
from sfglab.lab.sweep.rows import text_from_result

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


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
    """Run some jobs, one after the other.

    Args:
        task: What is run.
        code: `code_digest` of who started the sweep.
        jobs: What it is given.
    """
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
            reason = f"{type(error).__name__}: {error}"
            failure = Failure(job, reason, traceback.format_exc(), interrupt=stop)
            break
    return Done(tuple(finished), time.perf_counter() - start_s, failure)
