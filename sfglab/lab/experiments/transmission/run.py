"""Run the transmission experiment into one log: the grid, the ways beyond it, and the live cells."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.lab.experiments.transmission.beyond import simulate_way, ways
from sfglab.lab.experiments.transmission.cell import simulate_cell
from sfglab.lab.experiments.transmission.config import Config, grid, live_cells
from sfglab.lab.experiments.transmission.live import LiveStage, hosts_of
from sfglab.lab.experiments.transmission.live_rows import LiveRow, compare
from sfglab.lab.experiments.transmission.scenario import scenario_of
from sfglab.lab.hosts import HostsUnavailableError
from sfglab.lab.progress import progress_bar
from sfglab.lab.sweep import Workers, journals, sweep
from sfglab.record import LogWriter, run_context
from sfglab.rtps import CYCLONE_DDS
from sfglab.rtps import run as simulate

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from sfglab.lab.experiments.transmission.config import Point
    from sfglab.rtps import Scenario


P = TypeVar("P")


async def run(config: Config, path: Path) -> Path:
    """Run the experiment.

    The simulated parts are sweeps: interrupted, the same run goes on where it was, from journals beside the
    log.

    Args:
        config: What to run.
        path: The log.

    Raises:
        SweepError: A cell failed.
        ProcessFailedError: A process of the live part failed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    seeds = range(config.seed, config.seed + config.seeds)
    with journals(path, f"transmission-{config.profile}") as journal:
        tables = {
            "cell": _swept(simulate_cell, grid(config), seeds, journal("grid")),
            "lossless": _swept(simulate_cell, grid(config, loss=0.0), seeds[:1], journal("lossless")),
            "beyond": _swept(simulate_way, ways(config), seeds, journal("ways")),
        }
        hindrance, tables["live"] = await _run_live(config, seeds)
        with LogWriter(path) as log:
            log.write_metadata("run", run_context())
            log.write_metadata("config", {"experiment": "transmission", **asdict(config)})
            log.write_metadata("live", {"hindrance": hindrance})
            for table, rows in tables.items():
                _write(log, table, rows)
    return path


def _swept(
    task: Callable[[P, int], Any], points: Sequence[P], seeds: Sequence[int], journal: Path
) -> list[Any]:
    """Sweep in threads: the time is spent in compiled code."""
    return sweep(task, points, seeds, journal=journal, workers=Workers(threads=True))


def _write(log: LogWriter, table: str, rows: Sequence[Any]) -> None:
    # Times are places in the table, so that the same seeds give the same simulated rows to the byte.
    for place, row in enumerate(rows):
        log.write_row(table, row, log_time_ns=place)


async def _run_live(config: Config, seeds: Sequence[int]) -> tuple[str, list[LiveRow]]:
    """Run the live cells; the first of the result says what hindered, if anything."""
    cells = live_cells(config)
    if not cells:
        return "not asked for", []
    rows = []
    try:
        async with LiveStage(*hosts_of(_scenario(cells[0], config.seed))) as stage:
            with progress_bar(len(cells), "transmission live") as advance:
                for cell in cells:
                    played = await stage.play(_scenario(cell, config.seed), seed=config.seed)
                    models = [simulate(played.scenario, seed=seed) for seed in seeds]
                    rows += compare(cell, played, models)
                    advance(f"{cell.method}, {cell.rate_max_hz} Hz, depth {cell.depth}")
    except HostsUnavailableError as error:
        return error.reason, []
    return "", rows


def _scenario(cell: Point, seed: int) -> Scenario:
    return scenario_of(cell, seed=seed, vendor=CYCLONE_DDS)
