"""Pipeline processes: one for each running pipeline, and one in standby.

Each is ``python -m sfglab.fleet.decoder.process CONFIG``. Its imports take about a second; a standby
process has done them. Each pipeline has a process of its own. A bitstream that crashes the codec therefore
ends one stream only.

Orders: ``{"do": "open", "stream": {...}}`` with a `Route`, ``{"do": "serve", "transports": [...]}`` when
the transports of the local subscriptions change, ``{"do": "close"}``. Reports: ``ready``, ``opened``,
``closed`` after everything is released, ``broken`` with ``why``, and ``statistics``, `Statistics`,
periodically and at the end.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING

from sfglab.bus.address import BusAddress
from sfglab.codecs import FFMPEG_PACKET, CodecError, image_decoder
from sfglab.component import Orders, Report, Reporter, beside, is_set_before, run_component
from sfglab.fields import from_json
from sfglab.fleet.decoder.pipeline import Outputs, Statistics, run_pipeline
from sfglab.fleet.decoder.streams import IMAGE_TYPE, Route
from sfglab.messages import default_message, deserialize, serialize
from sfglab.processes import LineProcess, Member

if TYPE_CHECKING:
    from sfglab.bus import Node


_LOG = logging.getLogger(__name__)
REPORT_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerConfig:
    """Addresses of a pipeline process; equal addresses share one node."""

    remote: BusAddress  #: Domain of the compressed streams.
    local: BusAddress  #: Domain of the decoded topics.


class PipelineWorker:
    """Process that takes orders, runs one pipeline at a time from `remote` to `local`, and reports."""

    def __init__(self, remote: Node, local: Node, report: Reporter) -> None:
        self._remote = remote
        self._local = local
        self._report = report
        self._pipeline: asyncio.Task[None] | None = None
        self._outputs: Outputs | None = None

    async def run(self, orders: Orders) -> None:
        """Report that the worker is ready, and execute orders one by one until the task is cancelled."""
        self._report({"is": "ready"})
        try:
            while True:
                await self._obey(await orders.get())
        finally:
            await self._end()

    async def _obey(self, order: Report) -> None:
        if order["do"] == "open":
            await self._end()
            route = from_json(Route, order["stream"])
            # Before the task has begun, the next order may change the transports.
            self._outputs = Outputs(self._local, route, order["transports"])
            self._pipeline = asyncio.create_task(self._run_one(route, self._outputs))
        elif order["do"] == "serve" and self._outputs is not None:
            self._outputs.serve(order["transports"])
        elif order["do"] == "close":
            await self._end()
            self._report({"is": "closed"})

    async def _end(self) -> None:
        if self._pipeline is not None:
            self._pipeline.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._pipeline
            self._pipeline = None

    async def _run_one(self, route: Route, outputs: Outputs) -> None:
        counts = Statistics()
        try:
            self._report({"is": "opened"})
            async with beside(self._report_counts(counts)):
                await run_pipeline(route, remote=self._remote, outputs=outputs, counts=counts)
        except Exception as error:  # noqa: BLE001  # the decoder must know of any failure
            self._report({"is": "broken", "why": f"{type(error).__name__}: {error}"})
        finally:
            outputs.close()
            self._outputs = None
            self._report({"is": "statistics", **asdict(counts)})

    async def _report_counts(self, counts: Statistics) -> None:
        while True:
            await asyncio.sleep(REPORT_PERIOD_S)
            self._report({"is": "statistics", **asdict(counts)})


def _warm_up() -> None:
    """Do the work that is slow the first time: a subscriber would wait 0.3 s for it."""
    from importlib import import_module

    from sfglab.messages.dds import idl_struct

    import_module("sfglab.bus.shm.writer")
    with contextlib.suppress(CodecError):  # a stream that needs this codec reports the error
        image_decoder(FFMPEG_PACKET, "h264")
    for type_ in (FFMPEG_PACKET, IMAGE_TYPE):
        idl_struct(type_)
        deserialize(serialize(default_message(type_)), type_)


async def serve(config: WorkerConfig, report: Reporter, orders: Orders) -> None:
    """Run the pipeline process until cancelled: join its domains, and follow orders."""
    from sfglab.bus import Node

    _warm_up()
    async with contextlib.AsyncExitStack() as stack:
        local = await stack.enter_async_context(
            Node("agent_decoder_pipeline", **config.local.options())
        )
        remote = local
        if config.remote != config.local:
            remote = await stack.enter_async_context(
                Node("agent_decoder_pipeline", **config.remote.options())
            )
        await PipelineWorker(remote, local, report).run(orders)


END_GRACE_S = 2.0
#: Delay before the next standby process starts, s, because a starting pipeline needs the processor.
REFILL_DELAY_S = 2.0

Owner = Callable[["Worker", Report], None]


class Worker(LineProcess):
    """One pipeline process, as the decoder sees it."""

    is_ready = False  #: Whether the process has reported that it is ready.

    def assign(self, owner: Owner) -> None:
        """Send all further reports of the decoder process to an owner, also the report that it has ended."""
        self.on_report = partial(owner, self)

    async def end(self) -> None:
        """Tell the process to end and wait for that; end it by force after a grace period."""
        await self.close(grace_s=END_GRACE_S)


class WorkerPool:
    """Pipeline processes, with `spare` one of them in standby; with `refill`, an acquired one is replaced."""

    def __init__(self, config: WorkerConfig, *, spare: bool = True, refill: bool = True) -> None:
        module = "sfglab.fleet.decoder.process"
        self._member = Member(name="pipeline process", module=module, config=config)
        self._wants_spare = spare
        self._wants_refill = spare and refill
        self._spare: Worker | None = None
        self._workers: set[Worker] = set()
        self._refilling: asyncio.Task[None] | None = None
        self._closed = asyncio.Event()

    @property
    def pids(self) -> tuple[int, ...]:
        """Process ids of all workers, standby included."""
        return tuple(sorted(w.pid for w in self._workers if w.status is None))

    @property
    def warm(self) -> bool:
        """Whether a standby process, if there has to be one, is running and ready."""
        return not self._wants_spare or (self._spare is not None and self._spare.is_ready)

    async def start(self) -> None:
        """Start the standby process and return when it is ready.

        Raises:
            ProcessFailedError: The process failed to start.
        """
        if self._wants_spare:
            self._spare = await self._spawn()
            await self._spare.expect("ready", timeout_s=None)

    async def acquire(self, owner: Owner) -> Worker:
        """Return a process for one pipeline, whose reports go to the owner; a replacement may start later."""
        worker, self._spare = self._spare, None
        if worker is None:
            worker = await self._spawn()
        worker.buffers_reports = False
        worker.assign(owner)
        if self._wants_refill and (self._refilling is None or self._refilling.done()):
            self._refilling = asyncio.create_task(self._refill())
        return worker

    async def release(self, worker: Worker) -> None:
        """Take back a process whose pipeline has ended: to standby, or to its end if another one stands by."""
        worker.assign(self._on_spare_report)
        is_needed = self._wants_spare and self._spare is None and not self._closed.is_set()
        if worker.status is None and is_needed:
            self._spare = worker
        else:
            await worker.end()

    async def close(self) -> None:
        """End all workers and wait for them."""
        self._closed.set()
        if self._refilling is not None:
            await self._refilling
        ends = (worker.end() for worker in tuple(self._workers))
        for result in await asyncio.gather(*ends, return_exceptions=True):
            if isinstance(result, BaseException):
                _LOG.warning("decoder: the end of a pipeline process: %s", result)

    async def _refill(self) -> None:
        # Another pipeline may take the new spare process while this waits, and starts no refill of its own.
        while self._spare is None:
            refill_s = asyncio.get_running_loop().time() + REFILL_DELAY_S
            if await is_set_before(self._closed, refill_s):
                return
            try:
                if self._spare is None:
                    await self.release(await self._spawn())
            except OSError as error:
                _LOG.warning("decoder: no spare pipeline process: %s", error)
                return

    async def _spawn(self) -> Worker:
        worker = await Worker.start(self._member.name, self._member.command)
        worker.assign(self._on_spare_report)
        self._workers = {w for w in self._workers if w.status is None} | {worker}
        return worker

    def _on_spare_report(self, worker: Worker, report: Report) -> None:
        worker.is_ready |= report["is"] == "ready"
        if report["is"] == "ended" and worker is self._spare:
            self._spare = None


if __name__ == "__main__":
    run_component(WorkerConfig, serve)
