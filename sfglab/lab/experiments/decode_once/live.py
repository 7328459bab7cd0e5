"""Live parts: a camera on the edge host, the decoder and the subscribers on the consumer host."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.lab.cells import run_cells
from sfglab.lab.experiments.decode_once.experiment import (
    HANDED_ON,
    CellRow,
    Config,
    Group,
    LoadRow,
    Stage,
    ViewRow,
    check_stages,
    exp,
    groups_of,
)
from sfglab.lab.meters import MeterRow, measure
from sfglab.lab.streams import FIRST_PICTURE_S, LINGER_S, StreamProcesses
from sfglab.lab.workers.camera import CameraConfig
from sfglab.processes import Member, ProcessFailedError
from sfglab.record import LogReader
from sfglab.units import BITS_PER_MBIT, NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sfglab.component import Report
    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

HOSTS = ("consumer", "edge")
TOPIC = "/global/edge/camera_front/color/ffmpeg"
"""Topic of the camera's compressed stream."""
LOCAL_DOMAIN = 7  #: Domain of the decoded pictures on the consumer host.
_VIEWER = "sfglab.lab.workers.viewer"
_COUNTS = ("frames", "unreadable", "missed", "disordered", "broken")


def viewers(count: int) -> list[str]:
    """Return the names of a number of subscribers."""
    return [f"viewer {number}" for number in range(count)]


class StageProcesses(StreamProcesses):
    """The processes of a stage, which all its cells share."""

    def __init__(self, config: Config, stage: Stage, testbed: Testbed) -> None:
        self._stage = stage
        self._decoder_pids: tuple[int, ...] = ()
        self.topic = TOPIC  #: Topic of the compressed stream.
        super().__init__(config, testbed)

    def first_members(self) -> list[Member]:
        """Return subscribers, decoder and camera."""
        stage = self._stage
        local = BusAddress(domain_id=LOCAL_DOMAIN, interface="lo")
        camera = CameraConfig(
            places=((self.shared("edge"), self.topic),),
            codec=stage.codec,
            source=stage.source or self._config.source,
            seed=self._config.seed,
            encoder=self._config.encoder,
        )
        # One process serves one cell after the other, as a component container does: none starts
        # during a cell.
        decoder = DecoderConfig(
            remote=self.shared("consumer"),
            local=local,
            streams=(self.topic,),
            idle_timeout_s=LINGER_S,
            refill=False,
        )
        viewer = self.viewer_config(self.topic, local)
        most = max(stage.counts + stage.dds_counts + stage.network_counts)
        members = [
            Member(name=name, host="consumer", module=_VIEWER, config=viewer)
            for name in viewers(most)
        ]
        module = "sfglab.fleet.decoder.node"
        members.append(Member(name="decoder", host="consumer", module=module, config=decoder))
        module = "sfglab.lab.workers.camera"
        members.append(
            Member(name="camera", host="edge", module=module, config=camera, ready="running")
        )
        return members

    async def settle(self) -> None:
        """Wait until the decoder's process for pictures is ready."""
        self._decoder_pids = await self.warm("decoder")

    def pids(self, mode: str) -> dict[str, tuple[int, ...]]:
        """Return the process ids that a mode needs, by host."""
        consumer = [self[name].pid for name in self if name.startswith("viewer")]
        if mode in HANDED_ON:
            consumer += self._decoder_pids
        return {"consumer": tuple(consumer), "edge": (self["camera"].pid,)}

    async def look(self, count: int, **order: Any) -> None:
        """Let subscribers receive in a mode, and wait until each has a frame."""
        names = viewers(count)
        await self.ask("first", names, timeout_s=FIRST_PICTURE_S, do="look", **order)

    async def stop(self, count: int) -> list[Report]:
        """Let subscribers stop, and return their reports."""
        seen = await self.seen(viewers(count))
        return list(seen.values())

    async def measure(self, cell: CellRow) -> dict[str, list[Any]]:
        """Measure a cell.

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
            "load": load_rows(cell.cell, readings),
            "view": view_rows(cell.cell, seen),
            "cell": [cell],
        }


def load_rows(cell: int, readings: Iterable[MeterRow]) -> list[LoadRow]:
    """Return the rows of a cell's meter readings."""
    rows = []
    for reading in readings:
        assert reading.cpu_percent is not None, "every label has processes"
        assert reading.rx_bps is not None, "every label has an interface"
        row = LoadRow(
            cell=cell,
            label=reading.label,
            cpu_percent=reading.cpu_percent,
            rx_mbit_s=reading.rx_bps / BITS_PER_MBIT,
        )
        rows.append(row)
    return rows


def view_rows(cell: int, seen: Iterable[Report]) -> list[ViewRow]:
    """Return the rows of the subscribers' reports."""
    rows = []
    for viewer, report in enumerate(seen):
        counts = {name: report[name] for name in _COUNTS}
        ages_ns = report["ages_ns"] or [np.nan]
        age_ms = float(np.median(ages_ns)) / NS_PER_MS
        rows.append(ViewRow(cell=cell, viewer=viewer, age_ms=age_ms, **counts))
    return rows


@exp.part("stream", total=lambda config: len(config.stages))
async def record_streams(bench: Bench[Config]) -> None:
    """Record the first messages of each stream as they arrive at the consumer host."""
    check_stages(bench.config)
    for stage in bench.config.stages:
        alone = replace(stage, counts=(1,), dds_counts=(), network_counts=())
        path = bench.folder(f"stream {stage.codec}") / "stream.mcap"
        async with StageProcesses(bench.config, alone, bench.testbed) as processes:
            facts = {
                "topic": processes.topic,
                "type": routes_of_topic(processes.topic)[0].source_type,
                "encoder": processes.encoder,
                "source": stage.source or bench.config.source,
            }
            bench.metadata(f"stream_{stage.codec}", facts)
            await processes.look(1, mode="network", path=str(path))
            await asyncio.sleep(bench.config.raw_s)
            await processes.stop(1)
        copy_messages(bench, path)
        bench.advance(stage.codec)


def copy_messages(bench: Bench[Config], path: Path) -> None:
    """Copy messages of a log into that of the run, up to the configured amount."""
    left = bench.config.raw_bytes
    with LogReader(path) as reader:
        for message in reader.messages():
            left -= len(message.cdr)
            if left < 0:
                return
            bench.log.write_raw(
                message.topic,
                message.type_name,
                message.cdr,
                log_time_ns=message.log_time_ns,
                publish_time_ns=message.publish_time_ns,
            )


@exp.part("cells", total=lambda config: len(groups_of(config)))
async def measure_cells(bench: Bench[Config]) -> None:
    """Measure all cells, stream by stream."""
    config = bench.config

    async def play(processes: StageProcesses, group: Group, _: int) -> dict[str, list[Any]]:
        rows: dict[str, list[Any]] = {"load": [], "view": [], "cell": []}
        for cell in group.cells():
            for table, measured in (await processes.measure(cell)).items():
                rows[table] += measured
        return rows

    def write(rows: dict[str, list[Any]]) -> None:
        for table, measured in rows.items():
            bench.write_all(table, measured)

    await run_cells(
        bench,
        "cells",
        dict.fromkeys(groups_of(config), 1),
        stage_of=lambda group: group.stage,
        start=lambda stage: StageProcesses(config, stage, bench.testbed),
        play=play,
        write=write,
        at_once=1,
    )
