"""Run the cooperation experiment into one log: the sweep, contrasts, the runs that are drawn, a live drive."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from sfglab.arp.hallway import End
from sfglab.lab.experiments.cooperation.config import OPTIMUM, Config, Point, points_of
from sfglab.lab.experiments.cooperation.live import drive_live
from sfglab.lab.experiments.cooperation.replay import write_messages
from sfglab.lab.experiments.cooperation.simulated import SimulatedRun, run_point
from sfglab.lab.hosts import Network
from sfglab.lab.progress import progress_bar
from sfglab.lab.sweep import journals, sweep
from sfglab.qos import DEFAULT
from sfglab.record import LogWriter, run_context
from sfglab.rtps import Medium

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from sfglab.lab.experiments.cooperation.rows import CourseRow, TrackRow


LIVE_POINT = Point(method="OPT+LC", rate_max_hz=100, depth=OPTIMUM, vendor="cyclone_dds")
"""What is driven live, and simulated beside it: the live bus is Cyclone DDS."""

_CONTRASTED = ("none", "LC", "OPT", "OPT+LC")
_S = 1_000_000_000


def contrasts_of(config: Config) -> list[Point]:
    """Return what else is asked of the methods that matter.

    No loss at all; Cyclone DDS's timing; and of the optimisation only the rate, with ROS 2's default depth. All
    at the lowest and the highest Rmax.
    """
    ends = {min(config.rates_hz), max(config.rates_hz)}
    points = [p for p in points_of(config) if p.method in _CONTRASTED and p.rate_max_hz in ends]
    lossless = [replace(point, medium=Medium(loss=0.0)) for point in points]
    cyclone = [replace(point, vendor="cyclone_dds") for point in points]
    return [*lossless, *cyclone, *(replace(p, depth=DEFAULT.depth) for p in points if p.depth == OPTIMUM)]


def examples_of(rows: Sequence[CourseRow]) -> dict[str, CourseRow]:
    """Return the runs that are drawn: the first in the sweep's order that the paper's Fig. 17 and 18 speak of.

    A success with optimisation and local cache, else with any method; a failure without either, else of any.
    """
    successes = [row for row in rows if row.end == End.SUCCESS.value]
    failures = [row for row in rows if row.end != End.SUCCESS.value]
    wanted = {
        "success": [row for row in successes if row.method == "OPT+LC"] + successes,
        "failure": [row for row in failures if row.method == "none"] + failures,
    }
    return {name: found[0] for name, found in wanted.items() if found}


def point_of(row: CourseRow) -> Point:
    """Return the point that a run belongs to."""
    return Point(
        method=row.method,
        rate_max_hz=row.rate_max_hz,
        depth=row.depth,
        vendor=row.vendor,
        medium=Medium(loss=row.loss),
    )


async def run(config: Config, path: Path, *, separate: bool | None = None) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log; beside it stand the sweeps' journals, from which an interrupted run goes on.
        separate: False leaves the live drive out; None has it where the machine has separate hosts.

    Returns:
        The log's path.

    Raises:
        SweepError: A run failed.
        ProcessFailedError: A process of the live drive failed; everything simulated is in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with journals(path, f"cooperation-{config.profile}") as journal:
        rows = _swept(config, points_of(config), config.seeds, journal("courses"))
        more = _swept(config, contrasts_of(config), config.contrast_seeds, journal("contrasts"))
        await _write(config, path, rows, more, separate=separate)
    return path


async def _write(
    config: Config, path: Path, rows: list[CourseRow], more: list[CourseRow], *, separate: bool | None
) -> None:
    """Write what was swept, drive again what is drawn, and drive live."""
    with LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "cooperation", **asdict(config)})
        for row in rows:
            log.write_row("course", row, log_time_ns=round(row.ended_s * _S))
        for row in more:
            log.write_row("contrast", row, log_time_ns=round(row.ended_s * _S))
        examples = examples_of(rows)
        log.write_metadata("examples", {name: asdict(row) for name, row in examples.items()})
        for name, row in examples.items():
            tracked = SimulatedRun(point_of(row), row.seed, tracked=name)
            # Written out, because a NaN is not equal to itself.
            assert repr(tracked.run()) == repr(row), "the same point and seed are the same run"
            _write_tracks(log, tracked.tracks)
            write_messages(log, tracked.tracks)
        log.write_metadata("live", await _live(config, log, separate=separate))


def _swept(config: Config, points: Sequence[Point], seeds: int, journal: Path) -> list[CourseRow]:
    if not seeds:
        return []
    return sweep(run_point, points, range(config.seed, config.seed + seeds), journal=journal)


def _write_tracks(log: LogWriter, tracks: Iterable[TrackRow]) -> None:
    for track in tracks:
        log.write_row("track", track, log_time_ns=round(track.t_s * _S))


async def _live(config: Config, log: LogWriter, *, separate: bool | None) -> dict[str, Any]:
    """Drive live and simulate the same, and return what is to be said about it."""
    if not config.live_s or separate is False:
        return {"hosts": "no live drive was asked for"}
    capability = Network.available()
    if not capability.ok:
        return {"hosts": f"no live drive: {capability.reason}"}
    with progress_bar(1, "cooperation, live") as advance:
        drive = await drive_live(LIVE_POINT, config.seed, seconds=config.live_s)
        advance(f"{drive.lasted_s:.0f} s")
    twin = SimulatedRun(LIVE_POINT, config.seed, tracked="simulated")
    row = twin.run(limit_s=config.live_s)
    _write_tracks(log, drive.tracks)
    _write_tracks(log, twin.tracks)
    assert drive.radio is not None, "the live drive was on the radio"
    return {
        "hosts": f"separate hosts: network namespaces ({capability.how})",
        "end": "the time was over" if drive.verdict is None else drive.verdict.end.value,
        "lasted_s": drive.lasted_s,
        "held": drive.held,
        "radio": drive.radio.said(),
        "kept_up": drive.radio.kept_up,
        "simulated_end": "the time was over" if row.end == End.TIMEOUT.value else row.end,
        "simulated_held": row.held / (row.held + row.beams_sent),
    }
