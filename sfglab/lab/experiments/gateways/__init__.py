"""The gateway core explored, and the communication mapping of Fig. 8: paper C, sections 3 and 5.

Exact: every interleaving of core and surroundings up to a bound, the same with a core that does not claim the
hardware's topic and with every arrow of the core's table bent, and the edges across the boundary of the paper's
example in its three stages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.gateways.analysis import Results, load_results, measure_claims
from sfglab.lab.experiments.gateways.config import Config
from sfglab.lab.experiments.gateways.figure import figure_core, figure_mapping
from sfglab.lab.experiments.gateways.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "Results",
    "figure_core",
    "figure_mapping",
    "figures",
    "load_results",
    "measure_claims",
    "run",
]

NAME = "gateways"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {"gateway_core": figure_core(results), "graph_mapping": figure_mapping(results)}
