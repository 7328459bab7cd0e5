"""Live parts: a camera on the edge host, the decoder and the subscribers on the consumer host."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.lab.bench import as_row
from sfglab.lab.cells import run_cells
from sfglab.lab.experiments.decode_once.experiment import (
    HANDED_ON,
    CellRow,
    Config,
    LoadRow,
    ViewRow,
    check_counts,
    exp,
    groups_of,
)
from sfglab.lab.meters import MeterRow, measure
from sfglab.lab.streams import FIRST_PICTURE_S, LINGER_S, StreamProcesses
from sfglab.processes import Member, ProcessFailedError
from sfglab.record import LogReader
from sfglab.units import BITS_PER_MBIT, NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.component import Report
    from sfglab.lab.bench import Bench

HOSTS = ("consumer", "edge")
TOPIC = "/global/edge/camera_front/color/ffmpeg"
"""Topic of the camera's compressed stream."""
LOCAL_DOMAIN = 7  #: DDS domain of the decoded images on the consumer host.
_VIEWER = "sfglab.lab.workers.viewer"


def viewers(count: int) -> list[str]:
    """Return the names of a number of subscribers."""
    return [f"viewer {number}" for number in range(count)]


class Processes(StreamProcesses):
    """The processes of the run, which all cells share."""

    topic = TOPIC  #: Topic of the compressed stream.

    _decoder_pids: tuple[int, ...] = ()

    def first_members(self) -> list[Member]:
        """Return the processes of the subscribers, the decoder and the camera."""
        local = BusAddress(domain_id=LOCAL_DOMAIN, interface="lo")
        viewer = self.viewer_config(TOPIC, local)
        counts = self._config.counts + self._config.dds_counts + self._config.network_counts
        members = [
            Member(name=name, host="consumer", module=_VIEWER, config=viewer)
            for name in viewers(max(counts))
        ]
        # As in a component container, one process serves one cell after the other, so that no process starts
        # during a cell.
        decoder = DecoderConfig(
            remote=self.shared("consumer"),
            local=local,
            streams=(TOPIC,),
            idle_timeout_s=LINGER_S,
            refill=False,
        )
        module = "sfglab.fleet.decoder.node"
        members.append(Member(name="decoder", host="consumer", module=module, config=decoder))
        members.append(self.camera((self.shared("edge"), TOPIC)))
        return members

    async def settle(self) -> None:
        """Wait until the decoder's pipeline process is ready."""
        self._decoder_pids = await self.warm("decoder")

    def pids(self, mode: str) -> dict[str, tuple[int, ...]]:
        """Return the process ids that a mode needs, by host."""
        consumer = [self[name].pid for name in self if name.startswith("viewer")]
        if mode in HANDED_ON:
            consumer += self._decoder_pids
        return {"consumer": tuple(consumer), "edge": (self["camera"].pid,)}

    async def look(self, count: int, **order: Any) -> None:
        """Order a number of subscribers to receive, in the mode of the order, and wait until each has a frame."""
        names = viewers(count)
        await self.ask("first", names, timeout_s=FIRST_PICTURE_S, do="look", **order)

    async def stop(self, count: int) -> list[Report]:
        """Order a number of subscribers to stop, and return their reports."""
        seen = await self.seen(viewers(count))
        return list(seen.values())

    async def measure(self, cell: CellRow) -> dict[str, list[Any]]:
        """Measure a cell: its loads, and the frames of its subscribers.

        Returns:
            Rows by table.

        Raises:
            ProcessFailedError: A process ended with an error or did not answer in time, or the decoder's
                process was replaced during the measurement.
        """
        config = self._config
        await self.look(cell.subscribers, mode=cell.mode)
        await asyncio.sleep(config.settle_s)
        readings = await measure(
            config.samples * config.period_s,
            config.period_s,
            cpu=self.pids(cell.mode),
            interfaces={host: self._testbed.meter(host) for host in HOSTS},
        )
        seen = await self.stop(cell.subscribers)
        if cell.mode in HANDED_ON:
            await self.released("decoder")
            if await self.warm("decoder") != self._decoder_pids:
                raise ProcessFailedError("decoder: it started another process during a cell")
        return {
            "load": [*load_rows(cell.cell, readings)],
            "view": [*view_rows(cell.cell, seen)],
            "cell": [cell],
        }


def load_rows(cell: int, readings: Iterable[MeterRow]) -> Iterator[LoadRow]:
    """Yield the rows of a cell's meter readings."""
    for reading in readings:
        assert reading.rx_bps is not None, "every label has an interface"
        yield as_row(LoadRow, {"cell": cell, "rx_mbit_s": reading.rx_bps / BITS_PER_MBIT}, reading)


def view_rows(cell: int, seen: Iterable[Report]) -> Iterator[ViewRow]:
    """Yield the rows of the subscribers' reports."""
    for viewer, report in enumerate(seen):
        age_ms = float(np.median(report["ages_ns"] or [np.nan])) / NS_PER_MS
        yield as_row(ViewRow, {"cell": cell, "viewer": viewer, "age_ms": age_ms}, report)


@exp.part("stream")
async def record_stream(bench: Bench[Config]) -> None:
    """Record the stream's first messages as they arrive at the consumer host."""
    check_counts(bench.config)
    path = bench.folder("stream") / "stream.mcap"
    async with Processes(bench.config, bench.testbed) as processes:
        bench.metadata("stream_h264", {"topic": TOPIC, "encoder": processes.encoder})
        await processes.look(1, mode="network", path=str(path))
        await asyncio.sleep(bench.config.raw_s)
        await processes.stop(1)
    with LogReader(path) as reader:
        for message in reader.messages():
            bench.log.write_raw(
                message.topic,
                message.type_name,
                message.cdr,
                log_time_ns=message.log_time_ns,
                publish_time_ns=message.publish_time_ns,
            )


@exp.part("cells", total=lambda config: len(groups_of(config)))
async def measure_cells(bench: Bench[Config]) -> None:
    """Measure all cells on the same processes."""
    config = bench.config

    async def play(processes: Processes, cells: Sequence[CellRow], _: int) -> dict[str, list[Any]]:
        rows: dict[str, list[Any]] = {"load": [], "view": [], "cell": []}
        for cell in cells:
            for table, measured in (await processes.measure(cell)).items():
                rows[table] += measured
        return rows

    await run_cells(
        bench,
        "cells",
        dict.fromkeys(groups_of(config), 1),
        stage_of=lambda _: "all",
        start=lambda _: Processes(config, bench.testbed),
        play=play,
    )
