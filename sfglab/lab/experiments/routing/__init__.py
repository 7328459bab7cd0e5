"""Traffic routing by the naming schema: paper A, section 4.1, Eq. 1 and Table 1.

Agents behind routers and two parties in the global domain publish, subscribe, serve and call the same names:
those of Table 1, local ones and near misses. Recorded is who hears what of whom, and every endpoint that is
seen in the global domain; beside that the policy is checked exactly, on all standard names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.profiles import ConfigError
from sfglab.lab.experiments.routing.analysis import checks, latencies, load_results, measure_claims
from sfglab.lab.experiments.routing.config import Config
from sfglab.lab.experiments.routing.figure import routing_border
from sfglab.lab.experiments.routing.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "checks",
    "figures",
    "latencies",
    "load_results",
    "measure_claims",
    "routing_border",
    "run",
]

NAME = "routing"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    return {"routing_border": routing_border(load_results(log))}
