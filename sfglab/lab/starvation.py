"""Starvation of processes: few turns on one core, as on a machine with too much to do."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

LOOPS = 3  #: How many endless loops there are beside them.


def _pin(pids: set[int], cores: set[int]) -> None:
    for pid in pids:
        with suppress(OSError):
            for thread in Path(f"/proc/{pid}/task").iterdir():
                os.sched_setaffinity(int(thread.name), cores)


@contextmanager
def starving(pids: Callable[[], set[int]]) -> Iterator[None]:
    """Keep processes, as they are at each end of the block, on one core beside `LOOPS` endless loops."""
    cores = os.sched_getaffinity(0)
    loops = [
        subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"]) for _ in range(LOOPS)
    ]
    try:
        _pin(pids() | {loop.pid for loop in loops}, {max(cores)})
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
        _pin(pids(), cores)
