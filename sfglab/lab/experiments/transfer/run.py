"""Run the transfer experiment into one log: model, break-even, mappings, hardware, and processes."""

from __future__ import annotations

from contextlib import aclosing
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.transfer.hardware import area_rows, hardware_rows, what_is_missing
from sfglab.lab.experiments.transfer.live import cells_of, crossings
from sfglab.lab.experiments.transfer.modelled import model_rows
from sfglab.lab.experiments.transfer.placing import placed_rows
from sfglab.lab.experiments.transfer.worth import break_even_rows, sized_mapping_rows
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_bar
from sfglab.record import LogWriter, run_context
from sfglab.soc import load_graph

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from sfglab.lab.experiments.transfer.config import Config


GRAPH_FILE = "graphs/figure_8.yaml"


async def run(config: Config, path: Path) -> Path:
    """Run every part.

    Args:
        config: How much.
        path: The log.

    Raises:
        ProcessFailedError: A process of the live part failed; what came before is in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    missing = what_is_missing()
    with LogWriter(path) as log, progress_bar(_steps(config), "transfer") as advance:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "transfer", **asdict(config)})
        log.write_metadata("missing", missing)
        place = 0
        for table, row in _computed(config, missing):
            log.write_row(table, row, log_time_ns=place)
            place += 1
            if table in {"cycles", "area", "placed"}:
                advance(table)
        if config.live_rounds:
            async with aclosing(crossings(config)) as rows:
                async for crossing in rows:
                    log.write_row("crossing", crossing, log_time_ns=place)
                    place += 1
                    advance(f"{crossing.publisher}, {crossing.message_bytes} B")
    return path


def _computed(config: Config, missing: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """Return the rows that need no processes; what is drawn depends on the seed alone."""
    fits, graphs = (np.random.default_rng(seed) for seed in np.random.SeedSequence(config.seed).spawn(2))
    yield from model_rows(config.refits, fits)
    for even in break_even_rows(config.most_subscribers):
        yield "break_even", even
    for sized in sized_mapping_rows(load_graph(find_project().data / GRAPH_FILE), config.sizes):
        yield "sized_mapping", sized
    kinds = {
        "small": (config.small_graphs, config.small_nodes),
        "large": (config.large_graphs, config.large_nodes),
    }
    for placed in placed_rows(kinds, graphs):
        yield "placed", placed
    if "rtl" not in missing:
        yield from hardware_rows(config)
    if config.areas and "synthesis" not in missing:
        for area in area_rows(config):
            yield "area", area


def _steps(config: Config) -> int:
    """Return about how many steps of progress there are."""
    cells = 2 * config.live_rounds * len(cells_of(config))
    return cells + config.small_graphs + config.large_graphs + 20 * len(config.rtl_subscribers)
