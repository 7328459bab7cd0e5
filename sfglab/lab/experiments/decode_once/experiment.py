"""Runs in interleaved pairs, every reading kept: the stage's cells, one after the other."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from sfglab.fields import between
from sfglab.lab.baselines import PART, declare, measure_raw
from sfglab.lab.bench import Bench, as_row
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.decode_once.stage import HANDED_ON, MBIT, Running
from sfglab.lab.meters import MeterRow, measure
from sfglab.lab.ros2 import RosMissingError
from sfglab.record import LogReader

_ALL = tuple(range(1, 11))


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One camera stream and how often it is measured with how many subscribers."""

    codec: str  #: ``h264`` (colour) or ``rvl`` (depth).
    #: Where frames come from, as `open_source` takes it; empty: the configuration's source.
    source: str = ""
    counts: tuple[int, ...]  #: Numbers of local subscribers.
    #: Those of them with which the decoder also hands pictures on by DDS.
    dds_counts: tuple[int, ...] = ()
    #: Numbers of subscribers that receive without decoding, to tell network from decoding.
    network_counts: tuple[int, ...] = ()
    repeats: int = 1  #: How often every group of cells is measured.


_COLOUR = Stage(
    codec="h264", counts=_ALL, dds_counts=(1, 4, 7, 10), network_counts=(1, 4, 7, 10), repeats=2
)
_DEPTH = Stage(
    codec="rvl", source="stereo", counts=(1, 4, 7), dds_counts=(1, 7), network_counts=(4,)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    source: str = "photos"  #: Source of the colour stream; depth always comes from the stereo pair.
    stages: tuple[Stage, ...] = (_COLOUR, _DEPTH)  #: Streams, one after the other.
    #: Most local subscribers: a stream's larger numbers are left out.
    most: int = between(10, 2, 10)
    #: Numbers of subscribers of raw images, of real ROS 2 beside ours.
    ros2: tuple[int, ...] = (1, 3)
    samples: int = 3  #: Meter readings in a cell.
    period_s: float = 0.7  #: Time between readings, seconds.
    #: Wait in a cell between the last subscriber's first frame and the first reading, seconds.
    settle_s: float = 0.5
    raw_s: float = 3.0  #: How long the camera's raw messages are recorded into the log, seconds.
    raw_bytes: int = 1_200_000  #: The most that is recorded of one stream.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.
    #: How far DDS uses multicast between hosts: ``spdp`` (discovery only, as Cyclone DDS does on Wi-Fi, the
    #: paper's network) or ``default`` (data too, on a wired link).
    multicast: Literal["spdp", "default"] = "spdp"
    seed: int = 0  #: Seed of the frames' path and of the order of cells.

    def __post_init__(self) -> None:
        filled = tuple(replace(stage, source=stage.source or self.source) for stage in self.stages)
        object.__setattr__(self, "stages", filled)

    @property
    def measured(self) -> tuple[Stage, ...]:
        """The stages with at most so many subscribers."""
        return tuple(
            replace(
                stage,
                counts=tuple(n for n in stage.counts if n <= self.most),
                dds_counts=tuple(n for n in stage.dds_counts if n <= self.most),
                network_counts=tuple(n for n in stage.network_counts if n <= self.most),
            )
            for stage in self.stages
        )


exp = Experiment(
    "decode_once",
    Config,
    where="A 4.3, 5.2",
    smoke={
        # With two subscribers and two samples the load's growth was lost in noise on a busy machine.
        "stages": (Stage(codec="h264", counts=(1, 4), dds_counts=(1, 4), network_counts=(4,)),),
        "samples": 4,
        "period_s": 0.3,
        "settle_s": 0.1,
        "raw_s": 1.2,
        "ros2": (1,),
    },
    paper={
        "stages": (
            Stage(codec="h264", counts=_ALL, dds_counts=_ALL, network_counts=_ALL, repeats=2),
            Stage(
                codec="rvl",
                source="stereo",
                counts=_ALL,
                dds_counts=_ALL,
                network_counts=_ALL,
                repeats=2,
            ),
        ),
        "samples": 60,  # twice, so that replicates tell pure error
        "period_s": 1.0,
        "settle_s": 2.0,
        "raw_s": 10.0,
        "raw_bytes": 20_000_000,
    },
    hosts=("edge", "consumer"),
    actors=(
        Actor("camera", "edge", "encodes and publishes"),
        Actor("decoder", "consumer", "decodes once, on demand"),
        Actor("viewer", "consumer", "reads every pixel", count="1 to 10"),
    ),
    links=(
        Link("camera", "viewer", "compressed, to each (standard)", boundary="network"),
        Link("camera", "decoder", "compressed, once (dds, proxy)", boundary="network"),
        Link("decoder", "viewer", "pictures (dds)"),
        Link("decoder", "viewer", "pictures (proxy)", over="shared memory"),
    ),
)


@exp.table("cell")
class CellRow:
    """One cell: a number of subscribers in one mode, measured once."""

    cell: int  #: Counter from 0.
    codec: str  #: The stream's codec.
    mode: str  #: ``standard``, ``dds``, ``proxy`` or ``network``.
    subscribers: int  #: Local subscribers.
    repeat: int  #: Which repetition.
    first_frame_s: float  #: From the order to look until every subscriber had a frame, seconds.


@exp.table("load")
class LoadRow:
    """One meter reading in a cell."""

    cell: int  #: The cell.
    label: str  #: ``consumer`` or ``edge``.
    cpu_percent: float  #: CPU of the host's processes, per cent of one core.
    rx_mbit_s: float  #: Received at the host's interface, Mbit/s.
    tx_mbit_s: float  #: Sent at the host's interface, Mbit/s.
    window_s: float  #: Length of the reading's window, seconds.
    machine_percent: float  #: Everything else that ran on the machine, per cent of one core.
    steal_percent: float  #: Time the hypervisor took, per cent of one core.


@exp.table("view")
class ViewRow:
    """What one subscriber saw in a cell."""

    cell: int  #: The cell.
    viewer: int  #: Which subscriber.
    frames: int  #: Pictures (messages, in mode ``network``).
    unreadable: int  #: Pictures whose visible number could not be read.
    missed: int  #: Numbers skipped.
    disordered: int  #: Pictures that were not newer than the one before.
    broken: int  #: Messages that could not be decoded.
    checksum: str  #: Exclusive or over all pixels read, hexadecimal.
    #: Median time from capture stamp to picture in hand, milliseconds; NaN in mode ``network``.
    age_ms: float


@exp.table("pair")
class PairRow:
    """A picture that a subscriber held: the number in its pixels and the stamp in its header."""

    cell: int  #: The cell.
    viewer: int  #: Which subscriber.
    number: int  #: Read from the pixels.
    stamp_ns: int  #: Capture stamp.


@exp.table("camera")
class CameraRow:
    """A frame that the camera sent."""

    codec: str  #: The stream's codec.
    number: int  #: Drawn into its pixels.
    stamp_ns: int  #: Capture stamp.
    size_bytes: int  #: Compressed size.


def cells_of(stage: Stage, *, rng: np.random.Generator) -> list[tuple[str, int, int]]:
    """Return the cells of a stage in the order they are measured: (mode, subscribers, repeat).

    Standard, DDS and proxy of one count follow each other, in random order, so that a machine that slows down
    slows all; the counts are shuffled within each repetition.
    """
    cells: list[tuple[str, int, int]] = []
    for repeat in range(stage.repeats):
        modes = {n: ["standard", "proxy"] + ["dds"] * (n in stage.dds_counts) for n in stage.counts}
        groups = [[(mode, n, repeat) for mode in modes[n]] for n in stage.counts]
        if repeat == 0:
            groups += [[("network", n, 0)] for n in stage.network_counts]
        rng.shuffle(groups)
        for group in groups:
            rng.shuffle(group)
            cells += [(str(mode), int(n), int(r)) for mode, n, r in group]
    return cells


def _cells(config: Config) -> list[list[tuple[str, int, int]]]:
    """Return the cells of every stage."""
    rng = np.random.default_rng(config.seed)
    return [cells_of(stage, rng=rng) for stage in config.measured]


@exp.part("cells", total=lambda config: sum(map(len, _cells(config))))
async def measure_cells(bench: Bench[Config]) -> None:
    """Measure all cells, stream by stream."""
    first = 0
    for stage, cells in zip(bench.config.measured, _cells(bench.config), strict=True):
        keys = [
            {"cell": i, "codec": stage.codec, "mode": mode, "subscribers": n, "repeat": r}
            for i, (mode, n, r) in enumerate(cells, start=first)
        ]
        first += len(keys)
        async with Running(bench.config, stage, bench.testbed) as running:
            bench.metadata(f"stream_{stage.codec}", running.stream)
            await _record_raw(running, bench)
            for key in keys:
                await _measure_cell(key, running, bench)
                bench.advance(f"{stage.codec} {key['mode']} {key['subscribers']}")
        for number, stamp_ns, size_bytes in running.sent:
            row = {
                "codec": stage.codec,
                "number": number,
                "stamp_ns": stamp_ns,
                "size_bytes": size_bytes,
            }
            bench.write("camera", row, at_ns=stamp_ns)


declare(
    exp,
    "Raw images, by number of subscribers: real ones (rclpy) cost more than stand-ins and lose some",
)


@exp.part(
    PART, total=lambda config: 2 * config.samples * len(config.ros2), skips=(RosMissingError,)
)
async def measure_beside_ros2(bench: Bench[Config]) -> None:
    """Measure what subscribers of raw images cost, real ones beside ours."""
    quantities = ("CPU of a subscriber (% of a core)", "pictures received (%)")
    config = bench.config
    times: dict[str, Any] = {"repeats": config.samples, "look_s": 2 * config.period_s}
    await measure_raw(bench, quantities, counts=config.ros2, **times)


async def _record_raw(running: Running, bench: Bench[Config]) -> None:
    """Put the first of the camera's messages, as the consumer receives them, into the log."""
    part = bench.folder(f"raw {running.stream['topic'].rpartition('/')[2]}") / "raw.mcap"
    await running.record(part, bench.config.raw_s)
    left = bench.config.raw_bytes
    with LogReader(part) as reader:
        for m in reader.messages():
            left -= len(m.cdr)
            if left < 0:
                return
            times: dict[str, Any] = {
                "log_time_ns": m.log_time_ns,
                "publish_time_ns": m.publish_time_ns,
            }
            bench.log.write_raw(m.topic, m.type_name, m.cdr, **times)


async def _measure_cell(key: dict[str, Any], running: Running, bench: Bench[Config]) -> None:
    config, mode, count = bench.config, key["mode"], key["subscribers"]
    first_frame_s = await running.look(mode, count)
    await asyncio.sleep(config.settle_s)
    readings = await measure(
        config.samples * config.period_s,
        config.period_s,
        cpu={"consumer": running.consumer_pids(mode), "edge": running.edge_pids},
        interfaces={name: bench.testbed.meter(name) for name in ("consumer", "edge")},
        clock_ns=time.time_ns,
    )
    reports = await running.stop(count)
    if mode in HANDED_ON:
        await running.released("decoder")
    for reading in readings:
        bench.write("load", _load(key["cell"], reading), at_ns=reading.t_ns)
    for viewer, report in enumerate(reports):
        of = {"cell": key["cell"], "viewer": viewer}
        counts = {
            name: report[name]
            for name in ("frames", "unreadable", "missed", "disordered", "broken")
        }
        age_ms = float(np.median(report["ages_ns"])) / 1e6 if report["ages_ns"] else float("nan")
        bench.write(
            "view", {**of, **counts, "checksum": f"{report['checksum']:016x}", "age_ms": age_ms}
        )
        for number, stamp_ns in report["pairs"]:
            bench.write("pair", {**of, "number": number, "stamp_ns": stamp_ns})
    # Last, so that a cell that is in the log is complete.
    bench.write("cell", {**key, "first_frame_s": first_frame_s})


def _load(cell: int, reading: MeterRow) -> Any:
    assert reading.cpu_percent is not None, "every label has processes"
    assert reading.rx_bps is not None, "every label has an interface"
    assert reading.tx_bps is not None
    rates = {"rx_mbit_s": reading.rx_bps / MBIT, "tx_mbit_s": reading.tx_bps / MBIT}
    row = {"cell": cell, "machine_percent": reading.machine_cpu_percent, **rates}
    return as_row(LoadRow, row, reading)
