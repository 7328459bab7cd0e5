"""The run: model, break-even and mappings, node mapping, hardware, and processes."""

from __future__ import annotations

from contextlib import aclosing
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.transfer.experiment import Config, exp
from sfglab.lab.experiments.transfer.hardware import area_rows, hardware_rows, what_is_missing
from sfglab.lab.experiments.transfer.live import cells_of, crossings
from sfglab.lab.experiments.transfer.modelled import break_even_rows, model_rows, sized_mapping_rows
from sfglab.lab.experiments.transfer.placing import placed_rows
from sfglab.lab.paths import find_project
from sfglab.soc import load_graph

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench

GRAPH_FILE = "graphs/figure_8.yaml"


def _generators(config: Config) -> tuple[np.random.Generator, np.random.Generator]:
    """Return what draws fits, and what draws graphs."""
    fits, graphs = np.random.SeedSequence(config.seed).spawn(2)
    return np.random.default_rng(fits), np.random.default_rng(graphs)


@exp.part("model", timed=False)
def model(bench: Bench[Config]) -> None:
    """Write what the model says of Fig. 6 and 7, its fit run anew, and what follows for mapping."""
    config = bench.config
    for table, row in model_rows(config.refits, _generators(config)[0]):
        bench.write(table, row)
    bench.write_all("break_even", break_even_rows(config.most_subscribers))
    graph = load_graph(find_project().data / GRAPH_FILE)
    bench.write_all("sized_mapping", sized_mapping_rows(graph, config.sizes))


@exp.part("node mapping", total=lambda config: config.small_graphs + config.large_graphs, timed=False)
def node_mapping(bench: Bench[Config]) -> None:
    """Place random graphs."""
    config = bench.config
    kinds = {
        "small": (config.small_graphs, config.small_nodes),
        "large": (config.large_graphs, config.large_nodes),
    }
    for row in placed_rows(kinds, _generators(config)[1]):
        bench.write("placed", row)
        bench.advance(f"{row['nodes']} nodes")


@exp.part("hardware", total=lambda config: 20 * len(config.rtl_subscribers) + config.areas, timed=False)
def hardware(bench: Bench[Config]) -> None:
    """Simulate and synthesise the hardware, where that is installed; what is missing is written down."""
    config, missing = bench.config, what_is_missing()
    bench.metadata("missing", missing)
    if "rtl" not in missing:
        for table, row in hardware_rows(config.rtl_subscribers, config.rtl_check_bytes):
            bench.write(table, row)
            if table == "cycles":
                bench.advance(row["path"])
    if config.areas and "synthesis" not in missing:
        bench.write_all("area", area_rows(config.rtl_subscribers))


@exp.part("live", total=lambda config: 2 * config.live_rounds * len(cells_of(config)), timed=False)
async def live(bench: Bench[Config]) -> None:
    """Carry messages across processes."""
    if bench.config.live_rounds:
        async with aclosing(crossings(bench.config)) as rows:
            async for row in rows:
                bench.write("crossing", row)
                bench.advance(f"{row['publisher']}, {row['message_bytes']} B")
