"""Pipeline processes: one for each running pipeline, and one warm spare.

A worker's imports take about a second; a spare that has done them already lets a pipeline start in
milliseconds. Knows processes and lines; refuses to know streams and demand.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.fleet.decoder.protocol import ProtocolError, Ready, decode_line, encode_line

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.decoder.protocol import Line
    from sfglab.fleet.decoder.worker import WorkerConfig


END_GRACE_S = 2.0
REFILL_DELAY_S = 2.0
"""A pipeline that starts needs the processor more than the spare for the next one, and whoever only has a
glance gives its process back by then."""


class PoolError(SfglabError, RuntimeError):
    """No pipeline process can be started here."""


class Worker:
    """One pipeline process, as the decoder sees it.

    Attributes:
        owner: Who hears what it says; None while it is a spare.
        is_ready: Whether it has reported `Ready`.
    """

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.owner: Callable[[Worker, Line | None], None] | None = None
        self.is_ready = False
        self._process = process

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process is still there."""
        return self._process.returncode is None

    def send(self, line: Line) -> None:
        """Give it an order; a process that is gone already does not mind."""
        assert self._process.stdin is not None
        if self.alive and not self._process.stdin.is_closing():
            self._process.stdin.write(encode_line(line))

    def kill(self) -> None:
        """End it by force."""
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()

    async def end(self) -> None:
        """Close its input, which ends it; by force after a grace."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            await asyncio.wait_for(self._process.wait(), END_GRACE_S)
        except TimeoutError:
            self.kill()
            await self._process.wait()

    async def listen(self) -> None:
        """Pass on what it says to its owner until it is gone, then None."""
        assert self._process.stdout is not None
        while raw := await self._process.stdout.readline():
            try:
                line = decode_line(raw)
            except ProtocolError:
                self.kill()
                break
            if isinstance(line, Ready):
                self.is_ready = True
            if self.owner is not None:
                self.owner(self, line)
        await self._process.wait()
        if self.owner is not None:
            self.owner(self, None)


class WorkerPool:
    """Starts, lends, takes back and ends workers.

    Args:
        config: What every worker is told.
        spares: How many warm workers wait.
    """

    def __init__(self, config: WorkerConfig, *, spares: int = 1) -> None:
        self._argv = (sys.executable, "-m", "sfglab.fleet.decoder.worker", config.to_json())
        self._spares_wanted = spares
        self._spares: list[Worker] = []
        self._listeners: dict[Worker, asyncio.Task[None]] = {}
        self._filling = asyncio.Lock()
        self._refills: set[asyncio.Task[None]] = set()
        self._closed = asyncio.Event()

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of all workers, spares included."""
        return tuple(sorted(w.pid for w in self._listeners if w.alive))

    @property
    def warm(self) -> bool:
        """Whether all spares that should wait do, ready."""
        return len(self._spares) >= self._spares_wanted and all(w.is_ready for w in self._spares)

    async def start(self) -> None:
        """Start the spares and return when they are ready.

        Raises:
            PoolError: They do not start.
        """
        await self._fill()
        while not self.warm:
            await asyncio.sleep(0.02)
            if not self._spares:
                raise PoolError("decoder: a pipeline process ended while it started; its own words stand above")

    async def lend(self, owner: Callable[[Worker, Line | None], None]) -> Worker:
        """Return a worker for one pipeline, and start another spare a while later.

        Args:
            owner: Called with every line the worker says, and with None when it is gone.
        """
        worker = self._spares.pop(0) if self._spares else await self._spawn()
        worker.owner = owner
        refill = asyncio.create_task(self._refill())
        self._refills.add(refill)
        refill.add_done_callback(self._refills.discard)
        return worker

    async def take_back(self, worker: Worker) -> None:
        """Take a worker whose pipeline has ended; it becomes a spare, or ends if there are enough."""
        worker.owner = self._spare_gone
        if worker.alive and len(self._spares) < self._spares_wanted and not self._closed.is_set():
            self._spares.append(worker)
        else:
            await worker.end()

    async def close(self) -> None:
        """End all workers and wait for them."""
        self._closed.set()
        await asyncio.gather(*self._refills)
        await asyncio.gather(*(w.end() for w in list(self._listeners)))
        await asyncio.gather(*self._listeners.values())

    async def _refill(self) -> None:
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._closed.wait(), REFILL_DELAY_S)
        await self._fill()

    async def _fill(self) -> None:
        async with self._filling:
            while len(self._spares) < self._spares_wanted and not self._closed.is_set():
                worker = await self._spawn()
                worker.owner = self._spare_gone
                self._spares.append(worker)

    async def _spawn(self) -> Worker:
        process = await asyncio.create_subprocess_exec(
            *self._argv, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
        )
        worker = Worker(process)
        task = self._listeners[worker] = asyncio.create_task(worker.listen())
        task.add_done_callback(lambda _: self._listeners.pop(worker, None))
        return worker

    def _spare_gone(self, worker: Worker, line: Line | None) -> None:
        if line is None and worker in self._spares:
            self._spares.remove(worker)
