"""Run the decode-once experiment into one log: cells in interleaved pairs, every reading kept."""

from __future__ import annotations

import asyncio
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.decode_once.rows import CameraRow, CellRow, LoadRow, PairRow, ViewRow
from sfglab.lab.experiments.decode_once.stage import Running
from sfglab.lab.meters import measure
from sfglab.lab.progress import progress_bar
from sfglab.lab.testbed import Testbed
from sfglab.record import LogReader, LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.lab.experiments.decode_once.config import Config, Stage
    from sfglab.lab.experiments.decode_once.stage import View
    from sfglab.lab.meters import MeterRow


MBIT = 1e6


def cells_of(stage: Stage, *, rng: np.random.Generator) -> list[tuple[str, int, int]]:
    """Return the cells of a stage in the order they are measured: (mode, subscribers, repeat).

    Standard and proxy of one count follow each other, in random order, so that a machine that slows down
    slows both; the counts are shuffled within each repetition.
    """
    cells: list[tuple[str, int, int]] = []
    for repeat in range(stage.repeats):
        groups = [[("standard", n, repeat), ("proxy", n, repeat)] for n in stage.counts]
        if repeat == 0:
            groups += [[("network", n, 0)] for n in stage.network_counts]
        rng.shuffle(groups)
        for group in groups:
            rng.shuffle(group)
            cells += [(str(mode), int(n), int(r)) for mode, n, r in group]
    return cells


async def run(config: Config, path: Path, *, separate: bool | None = None) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log; it is readable up to the last finished chunk, whatever ends the run.
        separate: False insists on one host; None takes separate hosts where the machine can.

    Returns:
        The log's path.

    Raises:
        ProcessFailedError: A process of the experiment failed; finished cells are in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(config.seed)
    plan = [(stage, cells_of(stage, rng=rng)) for stage in config.stages]
    with Testbed("edge", "consumer", separate=separate) as testbed, LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "decode_once", **asdict(config)})
        log.write_metadata("hosts", {"description": testbed.description, "separate": testbed.separate})
        with progress_bar(sum(len(cells) for _, cells in plan), "decode once") as advance:
            first = 0
            for stage, cells in plan:
                rows = [
                    CellRow(cell=i, codec=stage.codec, mode=mode, subscribers=n, repeat=r, first_frame_s=0.0)
                    for i, (mode, n, r) in enumerate(cells, start=first)
                ]
                await _run_stage(config, stage, rows, _Bench(testbed, log, advance))
                first += len(rows)
    return path


@dataclass(frozen=True, slots=True)
class _Bench:
    """What every cell needs: the hosts, the log and the progress bar."""

    testbed: Testbed
    log: LogWriter
    advance: Callable[[str], None]


async def _run_stage(config: Config, stage: Stage, rows: list[CellRow], bench: _Bench) -> None:
    async with Running(config, stage, bench.testbed) as running:
        bench.log.write_metadata(f"stream_{stage.codec}", _stream(running, stage))
        await _record_raw(config, running, bench.log)
        for row in rows:
            await _measure_cell(row, config, running, bench)
            bench.advance(f"{row.codec} {row.mode} {row.subscribers}")
    _write_camera(running, stage, bench.log)


async def _record_raw(config: Config, running: Running, log: LogWriter) -> None:
    """Put the first of the camera's messages, as the consumer receives them, into the log."""
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "raw.mcap"
        await running.record(part, config.raw_s)
        left = config.raw_bytes
        with LogReader(part) as reader:
            for message in reader.messages():
                left -= len(message.cdr)
                if left < 0:
                    return
                log.write_raw(
                    message.topic,
                    message.type_name,
                    message.cdr,
                    log_time_ns=message.log_time_ns,
                    publish_time_ns=message.publish_time_ns,
                )


def _stream(running: Running, stage: Stage) -> dict[str, str]:
    return {
        "topic": running.topic,
        "type": running.type,
        "encoder": running.encoder,
        "source": stage.source,
    }


async def _measure_cell(row: CellRow, config: Config, running: Running, bench: _Bench) -> None:
    first_frame_s = await running.look(row.mode, row.subscribers)
    await asyncio.sleep(config.settle_s)
    readings = await measure(
        config.samples * config.period_s,
        config.period_s,
        cpu={"consumer": running.consumer_pids(row.mode), "edge": running.edge_pids},
        interfaces={name: bench.testbed.meter(name) for name in ("consumer", "edge")},
        clock_ns=time.time_ns,
    )
    views = await running.stop(row.subscribers)
    if row.mode == "proxy":
        await running.wait_for_release()
    _write_cell(replace(row, first_frame_s=first_frame_s), readings, views, bench.log)


def _write_cell(row: CellRow, readings: list[MeterRow], views: list[View], log: LogWriter) -> None:
    now_ns = time.time_ns()
    for reading in readings:
        log.write_row("load", _load_row(row.cell, reading), log_time_ns=reading.t_ns)
    for view in views:
        log.write_row("view", _view_row(row, view), log_time_ns=now_ns)
        for number, stamp_ns in view.report["pairs"]:
            pair = PairRow(cell=row.cell, viewer=view.viewer, number=number, stamp_ns=stamp_ns)
            log.write_row("pair", pair, log_time_ns=now_ns)
    # Last, so that a cell that is in the log is complete.
    log.write_row("cell", row, log_time_ns=now_ns)


def _load_row(cell: int, reading: MeterRow) -> LoadRow:
    assert reading.cpu_percent is not None, "every label has processes"
    assert reading.rx_bps is not None, "every label has an interface"
    assert reading.tx_bps is not None
    return LoadRow(
        cell=cell,
        label=reading.label,
        cpu_percent=reading.cpu_percent,
        rx_mbit_s=reading.rx_bps / MBIT,
        tx_mbit_s=reading.tx_bps / MBIT,
        window_s=reading.window_s,
        machine_percent=reading.machine_cpu_percent,
        steal_percent=reading.steal_percent,
    )


def _view_row(row: CellRow, view: View) -> ViewRow:
    report = view.report
    ages = report["ages_ns"]
    return ViewRow(
        cell=row.cell,
        viewer=view.viewer,
        frames=report["frames"],
        unreadable=report["unreadable"],
        missed=report["missed"],
        disordered=report["disordered"],
        broken=report["broken"],
        checksum=f"{report['checksum']:016x}",
        age_ms=float(np.median(ages)) / 1e6 if ages else float("nan"),
    )


def _write_camera(running: Running, stage: Stage, log: LogWriter) -> None:
    for number, stamp_ns, size_bytes in running.sent:
        row = CameraRow(codec=stage.codec, number=number, stamp_ns=stamp_ns, size_bytes=size_bytes)
        log.write_row("camera", row, log_time_ns=stamp_ns)
