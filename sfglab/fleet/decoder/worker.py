"""The process that runs one pipeline at a time: ``python -m sfglab.fleet.decoder.worker CONFIG``.

It is started before it is needed, so that a subscriber does not wait for imports; takes orders as lines on
standard input and reports on standard output; ends when its input ends, so that it never outlives the
decoder that started it. One process a pipeline: a bitstream that kills the codec kills one stream.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from sfglab.codecs import FFMPEG_PACKET, CodecError, image_decoder
from sfglab.errors import SfglabError
from sfglab.fleet.address import BusAddress
from sfglab.fleet.decoder.pipeline import IMAGE_TYPE, Counters, Outputs, run_pipeline
from sfglab.fleet.decoder.protocol import (
    RELAY,
    Close,
    Closed,
    Failed,
    Open,
    Opened,
    Ready,
    Serve,
    decode_line,
    encode_line,
)
from sfglab.messages import default_message, deserialize, serialize
from sfglab.pipes import claim_standard_output, run, standard_input_lines

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from sfglab.bus import Node
    from sfglab.fleet.decoder.protocol import Line


REPORT_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerConfig:
    """A worker's two sides; equal addresses share one node."""

    remote: BusAddress  #: Where the compressed streams are.
    local: BusAddress  #: Where the decoded topics go.

    def to_json(self) -> str:
        """Return the configuration as the worker's argument."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> WorkerConfig:
        """Read what `to_json` wrote."""
        values = json.loads(text)
        return cls(remote=BusAddress(**values["remote"]), local=BusAddress(**values["local"]))


class PipelineWorker:
    """Takes orders, runs one pipeline at a time, reports.

    Args:
        remote: Node on the remote streams' domain.
        local: Node on the local domain.
        report: Takes a line for the decoder.
    """

    def __init__(self, remote: Node, local: Node, report: Callable[[Line], None]) -> None:
        self._remote = remote
        self._local = local
        self._report = report
        self._pipeline: asyncio.Task[None] | None = None
        self._outputs: Outputs | None = None

    async def run(self, orders: AsyncIterator[Line]) -> None:
        """Serve until the orders end."""
        self._report(Ready())
        try:
            async for order in orders:
                await self._obey(order)
        finally:
            await self._end()

    async def _obey(self, order: Line) -> None:
        if isinstance(order, Open):
            await self._end()
            self._pipeline = asyncio.create_task(self._run_one(order))
        elif isinstance(order, Serve) and self._outputs is not None:
            self._outputs.serve(order.transports)
        elif isinstance(order, Close):
            await self._end()
            self._report(Closed())

    async def _end(self) -> None:
        if self._pipeline is not None:
            self._pipeline.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._pipeline
            self._pipeline = None

    async def _run_one(self, order: Open) -> None:
        type_ = order.source_type if order.codec == RELAY else IMAGE_TYPE
        outputs = self._outputs = Outputs(self._local, type_, order.local_topic)
        counters = Counters()
        reports: asyncio.Task[None] | None = None
        try:
            self._report(Opened())
            reports = asyncio.create_task(self._report_counts(counters))
            await run_pipeline(order, remote=self._remote, outputs=outputs, counters=counters)
        except Exception as error:  # noqa: BLE001  # whatever broke it, the decoder must hear of it
            self._report(Failed(why=f"{type(error).__name__}: {error}"))
        finally:
            if reports is not None:
                reports.cancel()
            outputs.close()
            self._outputs = None

    async def _report_counts(self, counters: Counters) -> None:
        while True:
            await asyncio.sleep(REPORT_PERIOD_S)
            self._report(counters.snapshot())


async def _orders() -> AsyncIterator[Line]:
    async for raw in standard_input_lines():
        yield decode_line(raw)


def _warm_up() -> None:
    """Do everything that takes long the first time: 0.3 s that a subscriber would wait for."""
    from importlib import import_module

    from sfglab.messages.dds import idl_struct

    import_module("sfglab.bus.shm.writer")
    with contextlib.suppress(CodecError):  # a stream that needs it will say so
        image_decoder(FFMPEG_PACKET, "h264")
    for type_ in (FFMPEG_PACKET, IMAGE_TYPE):
        idl_struct(type_)
        deserialize(serialize(default_message(type_)), type_)


async def _main(config: WorkerConfig) -> None:
    from sfglab.bus import Node

    write = claim_standard_output()
    _warm_up()
    async with contextlib.AsyncExitStack() as stack:
        local = await stack.enter_async_context(Node("agent_decoder_pipeline", **asdict(config.local)))
        remote = local
        if config.remote != config.local:
            remote = await stack.enter_async_context(Node("agent_decoder_pipeline", **asdict(config.remote)))
        worker = PipelineWorker(remote, local, lambda line: write(encode_line(line)))
        await worker.run(_orders())


def main() -> None:
    """Run the worker with the configuration given as its one argument."""
    # The decoder decides when workers end; an interrupt from the terminal reaches it as well.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        run(_main(WorkerConfig.from_json(sys.argv[1])))
    except SfglabError as error:
        sys.exit(f"sfglab: decoder pipeline: {error}")


if __name__ == "__main__":
    main()
