"""Caches and balanced QoS: paper B, sections 2.2 to 2.4, Fig. 3 and 5, Eq. 1 to 6, Table 1.

What local cache and cache control hold back of the sensors' readings, what a lost change does and what a
longest silence does about it; the printed optimum by CVXPY and by hand, and our own problem with its Pareto
front.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.balancing.analysis import load_results, measure_claims, saved, staleness
from sfglab.lab.experiments.balancing.config import Config
from sfglab.lab.experiments.balancing.figure import figure_caches, figure_qos, figure_stale
from sfglab.lab.experiments.balancing.run import run
from sfglab.lab.experiments.profiles import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "figure_caches",
    "figure_qos",
    "figure_stale",
    "figures",
    "load_results",
    "measure_claims",
    "run",
    "saved",
    "staleness",
]

NAME = "balancing"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {
        "balancing_caches": figure_caches(results),
        "balancing_stale": figure_stale(results),
        "balancing_qos": figure_qos(results),
    }
