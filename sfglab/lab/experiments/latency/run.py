"""Run the latency experiment into one log: looks at all paths, interleaved, at phases drawn over the group."""

from __future__ import annotations

import asyncio
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.latency.config import GLASS_PATHS, PATHS, Config
from sfglab.lab.experiments.latency.rows import IdleRow, LookRow, ShotRow, SightRow
from sfglab.lab.experiments.latency.stage import Running
from sfglab.lab.meters import measure
from sfglab.lab.progress import progress_bar
from sfglab.lab.testbed import Testbed
from sfglab.record import LogWriter, run_context

if TYPE_CHECKING:
    from pathlib import Path


MBIT = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """One subscription to be made."""

    repeat: int  #: Which repetition.
    path: str  #: One of `PATHS`.
    phase: float  #: When in the group of pictures, 0 to 1.


def looks_of(config: Config, *, rng: np.random.Generator) -> list[Look]:
    """Return all looks in the order in which they are made.

    Every repetition subscribes to all paths in random order at one phase of the group of pictures; the phases
    are drawn from equal shares of the group (stratified), so that there is little chance in the mean wait for a
    key frame.
    """
    shares = (rng.permutation(config.repeats) + rng.uniform(size=config.repeats)) / config.repeats
    return [
        Look(repeat=repeat, path=str(path), phase=float(phase))
        for repeat, phase in enumerate(shares)
        for path in rng.permutation(PATHS)
    ]


async def run(config: Config, path: Path, *, separate: bool | None = None) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log; it is readable up to the last finished chunk, whatever ends the run.
        separate: False insists on one host; None takes separate hosts where the machine can.

    Returns:
        The log's path.

    Raises:
        ProcessFailedError: A process of the experiment failed; finished looks are in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    looks = looks_of(config, rng=np.random.default_rng(config.seed))
    with Testbed("edge", "consumer", separate=separate) as testbed, LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "latency", **asdict(config)})
        log.write_metadata("hosts", {"description": testbed.description, "separate": testbed.separate})
        running = Running(config, testbed)
        async with running:
            log.write_metadata("stream", {"encoder": running.encoder, "gop_s": running.gop_s})
            await running.settle()
            await _first_of_all(running)
            await _measure_idle(config, running, testbed, log)
            with progress_bar(len(looks), "latency") as advance:
                for number, look in enumerate(looks):
                    await _measure_look(number, look, config, running, log)
                    advance(look.path)
        for frame, stamp_ns, size_bytes in running.sent:
            row = ShotRow(number=frame, stamp_ns=stamp_ns, size_bytes=size_bytes)
            log.write_row("camera", row, log_time_ns=stamp_ns)
    return path


async def _first_of_all(running: Running) -> None:
    """Look once at every path, unmeasured: what only the first time of a process costs is not asked here."""
    for path in PATHS:
        await running.look(path)
        await running.stop(path)


async def _measure_idle(config: Config, running: Running, testbed: Testbed, log: LogWriter) -> None:
    """Measure what the edge pays while nobody looks."""
    before, started = running.loopback_bytes(), time.monotonic()
    readings = await measure(
        config.idle_s,
        config.idle_s,
        cpu=running.pids,
        interfaces=dict.fromkeys(running.pids, testbed.meter("edge")),
        clock_ns=time.time_ns,
    )
    carried = (running.loopback_bytes() - before) * 8 / (time.monotonic() - started) / MBIT
    for reading in readings:
        assert reading.cpu_percent is not None, "every label has a process"
        assert reading.tx_bps is not None, "every label has an interface"
        row = IdleRow(
            label=reading.label,
            cpu_percent=reading.cpu_percent,
            tx_mbit_s=reading.tx_bps / MBIT,
            loopback_mbit_s=carried,
            window_s=reading.window_s,
        )
        log.write_row("idle", row, log_time_ns=reading.t_ns)


async def _measure_look(number: int, look: Look, config: Config, running: Running, log: LogWriter) -> None:
    await running.wait_for_phase(look.phase)
    running.replays.clear()
    first = await running.look(look.path)
    if look.path in GLASS_PATHS:
        await asyncio.sleep(config.look_s)
    seen = await running.stop(look.path)
    now_ns = time.time_ns()
    for picture, seen_ns in seen["sightings"]:
        sight = SightRow(look=number, number=picture, seen_ns=seen_ns)
        log.write_row("sight", sight, log_time_ns=seen_ns)
    # Last, so that a look that is in the log is complete.
    log.write_row("look", _row(number, look, first, seen, running.replays), log_time_ns=now_ns)


def _row(
    number: int, look: Look, first: dict[str, Any], seen: dict[str, Any], replays: list[tuple[int, int]]
) -> LookRow:
    return LookRow(
        look=number,
        repeat=look.repeat,
        path=look.path,
        phase=look.phase,
        ordered_ns=first["ordered_ns"],
        first_ns=first["seen_ns"],
        pictures=seen["frames"],
        unreadable=seen["unreadable"],
        missed=seen["missed"],
        disordered=seen["disordered"],
        broken=seen["broken"],
        replay_packets=sum(packets for packets, _ in replays),
        replay_bytes=sum(size for _, size in replays),
    )
