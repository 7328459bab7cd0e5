"""Driving: paper C, section 6, Fig. 9.

A car goes round simulated towns by its camera, past red lights, with every node of the application real; and
the node chain from image to command is timed with its shared topic in software and with a gateway, under the
memory model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.driving.analysis import chain_table, load_results, node_table, stops
from sfglab.lab.experiments.driving.animation import film, show_film
from sfglab.lab.experiments.driving.claim import measure_claims
from sfglab.lab.experiments.driving.config import Config
from sfglab.lab.experiments.driving.figure import figure_chain, figure_lap, figure_laps
from sfglab.lab.experiments.driving.replay import write_rerun
from sfglab.lab.experiments.driving.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "chain_table",
    "figure_chain",
    "figure_lap",
    "figure_laps",
    "figures",
    "film",
    "load_results",
    "measure_claims",
    "node_table",
    "run",
    "show_film",
    "stops",
    "write_rerun",
]

NAME = "driving"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {
        "driving_chain": figure_chain(results),
        "driving_lap": figure_lap(results, log),
        "driving_laps": figure_laps(results),
    }
