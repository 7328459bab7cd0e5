"""Run the driving experiment into one log: laps, the chain, and one lap again as it is drawn."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.driving.chain import chain_of, drive_lap, nodes_of, time_chain, transfers_of
from sfglab.lab.experiments.driving.recorder import record_lap, town_metadata
from sfglab.lab.experiments.driving.replay import write_messages
from sfglab.lab.sweep import Workers, journals, sweep
from sfglab.record import LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sfglab.lab.experiments.driving.config import Config
    from sfglab.lab.experiments.driving.recorder import Moment
    from sfglab.lab.experiments.driving.rows import DrivingLapRow
    from sfglab.soc.driving import Lap


_LOCAL, _ALONE = Workers(), Workers(count=1)
_S = 1_000_000_000


def run(config: Config, path: Path, *, workers: Workers = _LOCAL) -> Path:
    """Run the experiment.

    Laps and chain are sweeps: interrupted, the same run goes on where it was, from journals beside the log.

    Args:
        config: What to run.
        path: The log.
        workers: Who drives the laps; the chain is timed by one worker alone.

    Returns:
        The log's path.

    Raises:
        SweepError: A lap broke off with an error.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    seeds = range(config.seed, config.seed + config.laps)
    alone = Workers(count=1, threads=True) if workers.threads else _ALONE
    with journals(path, f"driving-{config.profile}") as journal:
        laps = sweep(drive_lap, [config.lap], seeds, journal=journal("laps"), workers=workers)
        [timed] = sweep(time_chain, [config.chain], seeds[:1], journal=journal("chain"), workers=alone)
        lap, moments = record_lap(config.seed, config.lap.limit_s)
        _check_same(lap, laps[0])
        chain = chain_of(config.chain)
        tables = {
            "lap": laps,
            "chain": timed,
            "node": nodes_of(chain),
            "transfer": transfers_of(chain),
        }
        _write(config, path, tables, moments)
    return path


def _check_same(lap: Lap, row: DrivingLapRow) -> None:
    """Make sure that the lap that is drawn is the one that was judged."""
    verdict = asdict(lap.verdict)
    assert {name: getattr(row, name) for name in verdict} == verdict, "the same seed is the same lap"


def _write(config: Config, path: Path, tables: dict[str, Sequence[Any]], moments: Sequence[Moment]) -> None:
    town = town_metadata(config.seed)
    with LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "driving", **asdict(config)})
        log.write_metadata("town", town)
        for table, rows in tables.items():
            for place, row in enumerate(rows):
                log.write_row(table, row, log_time_ns=place)
        for moment in moments:
            log.write_row("track", moment.row, log_time_ns=round(moment.row.t_s * _S))
        write_messages(log, town, moments)
