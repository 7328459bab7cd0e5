"""Transmission: paper B, section 3.1, Tables 1 and 2, Fig. 8 to 11.

Three robots send what their sensors say to the station, and "Hello" goes from robot 1 through the station back
to robot 1: latency and loss for every rate, depth and method, and where each lost "Hello" was lost.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.profiles import ConfigError
from sfglab.lab.experiments.transmission.analysis import (
    agreement,
    cells,
    compare_ways,
    load_results,
    measure_claims,
    order,
)
from sfglab.lab.experiments.transmission.config import Config, Point, grid
from sfglab.lab.experiments.transmission.figure import (
    figure_beyond,
    figure_fates,
    figure_latency,
    figure_live,
    figure_loss,
)
from sfglab.lab.experiments.transmission.run import run
from sfglab.lab.experiments.transmission.scenario import balance_of, scenario_of

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "Point",
    "agreement",
    "balance_of",
    "cells",
    "compare_ways",
    "figure_beyond",
    "figure_fates",
    "figure_latency",
    "figure_live",
    "figure_loss",
    "figures",
    "grid",
    "load_results",
    "measure_claims",
    "order",
    "run",
    "scenario_of",
]

NAME = "transmission"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {
        "transmission_latency": figure_latency(results),
        "transmission_loss": figure_loss(results),
        "transmission_fates": figure_fates(results),
        "transmission_beyond": figure_beyond(results),
        "transmission_live": figure_live(results),
    }
