"""Run the experiment on caches and balanced QoS into one log."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from sfglab.arp.robots import SENSORS, cdr_bytes, object_bytes
from sfglab.lab.experiments.balancing.caches import cache_rows
from sfglab.lab.experiments.balancing.front import front_rows
from sfglab.lab.experiments.balancing.optimum import balance_checks, balance_rows
from sfglab.lab.experiments.balancing.rows import TableOneRow
from sfglab.lab.experiments.balancing.stale import stale_rows
from sfglab.lab.progress import progress_bar
from sfglab.record import LogWriter, run_context

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.lab.experiments.balancing.config import Config


def run(config: Config, path: Path) -> Path:
    """Run the experiment; nothing in it depends on the machine's speed.

    Args:
        config: What to run.
        path: The log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "balancing", **asdict(config)})
        with progress_bar(4, "balancing") as advance:
            caches, checks = cache_rows(config)
            advance("caches")
            stale, shown = stale_rows(config)
            advance("lost changes")
            balanced = balance_rows(config)
            advance("Eq. 6")
            front = front_rows(config)
            advance("Pareto front")
        _write(log, "table_one", _table_one())
        _write(log, "cache", caches)
        _write(log, "check", [*checks, *balance_checks(balanced)])
        _write(log, "stale", stale)
        _write(log, "shown", shown)
        _write(log, "balance", balanced)
        _write(log, "front", front)
    return path


def _table_one() -> list[TableOneRow]:
    return [
        TableOneRow(
            sensor=sensor.name,
            type=sensor.type,
            table_bytes=sensor.table_bytes,
            object_bytes=object_bytes(sensor),
            cdr_bytes=cdr_bytes(sensor),
            change_s=sensor.change_s,
        )
        for sensor in SENSORS.values()
    ]


def _write(log: LogWriter, table: str, rows: list[Any]) -> None:
    # Nothing here has a time of its own: places in the table, so that a run gives the same rows again.
    for place, row in enumerate(rows):
        log.write_row(table, row, log_time_ns=place)
