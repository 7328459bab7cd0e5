"""Sweeps of runs that are still to come, computed while the processors have nothing else to do.

Live parts mostly wait. Results go into the journals in which the runs look for them, so that a run takes what
is there and computes the rest: its rows are the same. Whoever is measured has a processor when it wants one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.lab.experiments import experiment
from sfglab.lab.progress import progress_to
from sfglab.lab.sweep.run import begin_worker

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from multiprocessing.context import SpawnProcess
    from multiprocessing.process import BaseProcess

_LEAST_NICE = 19
_NICE = 10  # of two that want a processor, nine tenths go to who is measured
_END_S = 10.0


@contextmanager
def sweeps_ahead(runs: Mapping[str, Mapping[str, Any]]) -> Iterator[Callable[[str], None]]:
    """Compute sweeps of experiments, one after the other, from their profiles and fields; in the end, stop.

    Yields what is to be called before an experiment runs itself: what is not finished is left to it.
    """
    waiting = dict(runs)
    process = _start(waiting)

    def leave(name: str) -> None:
        nonlocal process
        if waiting.pop(name, None) is not None:
            end_process(process)
            process = _start(waiting)

    try:
        yield leave
    finally:
        end_process(process)


def _start(runs: Mapping[str, Mapping[str, Any]]) -> SpawnProcess:
    process = multiprocessing.get_context("spawn").Process(target=_compute, args=(runs,))
    if runs:
        process.start()
    return process


def end_process(process: BaseProcess) -> None:
    """End a process, by force if it does not end in time; harmless if it has ended."""
    if process.is_alive():
        process.terminate()
        process.join(_END_S)
        process.kill()
        process.join()


def give_way(pid: int, nice: int = _NICE) -> None:
    """Let a process and the threads that it has, and what they start, work only where others leave room."""
    with suppress(
        OSError
    ):  # where the scheduler groups by session, a priority counts within its own
        Path(f"/proc/{pid}/autogroup").write_text(f"{nice}", encoding="ascii")
    with suppress(OSError):  # it has ended
        for thread in Path(f"/proc/{pid}/task").iterdir():
            os.setpriority(os.PRIO_PROCESS, int(thread.name), nice)


def _compute(runs: Mapping[str, Mapping[str, Any]]) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # so that its workers are ended, too
    begin_worker()
    os.setsid()
    give_way(os.getpid(), _LEAST_NICE)
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    with progress_to(lambda _: None):
        for name, fields in runs.items():
            with suppress(SfglabError):  # the run itself will say it
                experiment(name).sweep_ahead(**fields)
