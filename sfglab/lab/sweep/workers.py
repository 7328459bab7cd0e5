"""Where a sweep runs: processes or threads of this machine, or a cluster that somebody else keeps.

It alone starts anything. Local workers talk over loopback alone, show no dashboard, and are gone, with their
files, when the sweep is.
"""

from __future__ import annotations

import asyncio
import logging
import os
import shutil
import signal
import threading
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.lab.sweep.errors import SweepError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


SCHEDULER_VARIABLE = "SFGLAB_SCHEDULER"
"""Environment variable with a scheduler's address, for programs that do not name one."""

_CONNECT_S = 10.0
_GRACE_S = 0.2
_LOOPBACK = "127.0.0.1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Who does the work."""

    count: int | None = None  #: How many local workers; None: as many as this process may use cores.
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
def connected(workers: Workers, scratch: Path) -> Iterator[Any]:
    """Connect to workers, start them if need be, and leave nothing of one's own behind.

    Args:
        workers: Which.
        scratch: Folder for the local workers' files; removed before and after.

    Yields:
        A `distributed.Client`.

    Raises:
        SweepError: There is no scheduler at the address, or it has no workers.
    """
    address = workers.scheduler or os.environ.get(SCHEDULER_VARIABLE)
    with _quiet(scratch), _cluster(address) if address else _local(workers, scratch) as client:
        if not client.nthreads():
            raise SweepError(f"workers: the scheduler at {address} has no workers; start some and try again")
        yield client


@contextmanager
def _cluster(address: str) -> Iterator[Any]:
    from distributed import Client

    try:
        client = Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise SweepError(f"workers: scheduler: given {address!r}, where none answers ({error})") from error
    with client:
        yield client


@contextmanager
def _local(workers: Workers, scratch: Path) -> Iterator[Any]:
    from distributed import Client

    shutil.rmtree(scratch, ignore_errors=True)
    try:
        with _started(workers, scratch) as cluster, Client(cluster, set_as_default=False) as client:
            try:
                yield client
            except BaseException:
                if not workers.threads:
                    cluster.sync(_end_at_once, cluster)
                raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


async def _end_at_once(cluster: Any) -> None:
    """End worker processes in the middle of what they do; dask would wait for them, and then some."""
    await asyncio.gather(*(nanny.close(timeout=_GRACE_S) for nanny in cluster.workers.values()))


def _started(workers: Workers, scratch: Path) -> Any:
    from distributed import LocalCluster

    count = workers.count or len(os.sched_getaffinity(0))
    with _deaf():
        return LocalCluster(
            n_workers=1 if workers.threads else count,
            threads_per_worker=count if workers.threads else 1,
            processes=not workers.threads,
            host=None if workers.threads else _LOOPBACK,
            dashboard_address=f"{_LOOPBACK}:0",
            worker_dashboard_address=f"{_LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            local_directory=str(scratch),
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        )


@contextmanager
def _deaf() -> Iterator[None]:
    """Ignore Ctrl-C while processes are started, which inherit that: the sweep ends them, not the terminal."""
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before is None:
        yield  # signals are not ours to set
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _quiet(scratch: Path) -> Iterator[None]:
    """Keep the scheduler's talk about its own comings and goings to itself, and its files in one place."""
    import dask.config
    import distributed  # noqa: F401 - it brings the settings that are changed here, and must come first

    log = logging.getLogger("distributed")
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with dask.config.set(
            {
                "distributed.scheduler.http.routes": [],
                "distributed.worker.http.routes": [],
                "temporary-directory": str(scratch),
            }
        ):
            yield
    finally:
        log.setLevel(before)
