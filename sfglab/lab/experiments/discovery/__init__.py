"""Fleet discovery: paper A, sections 4.1, 4.2 and 5.3, Fig. 9.

Fleets of 2 to 6 agents with ten publishing and ten subscribing nodes each are started by one signal.
*Standard*: all nodes share one DDS domain. *Routed*: every agent has a domain of its own, and its router lets
through what Table 1 names. Measured is how long each agent takes to know all its peers, and what its interface
receives until then. Larger fleets are routed only, and beyond what one machine carries they are simulated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.discovery.analysis import load_results, measure_claims, samples, summary
from sfglab.lab.experiments.discovery.config import Config, Scale, Stage
from sfglab.lab.experiments.discovery.figure import figure_9, figure_scale
from sfglab.lab.experiments.discovery.run import run
from sfglab.lab.experiments.profiles import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "Scale",
    "Stage",
    "figure_9",
    "figure_scale",
    "figures",
    "load_results",
    "measure_claims",
    "run",
    "samples",
    "summary",
]

NAME = "discovery"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    drawn = {"discovery_scale": figure_scale(results)}
    return drawn if results.cells.empty else {"discovery_fleet": figure_9(results), **drawn}
