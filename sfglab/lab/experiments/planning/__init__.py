"""Planning: paper A, section 4.5, Fig. 7.

Trajectories, headings, interpolation, re-timing, clearance, exchange, edits and files are checked on random
cases; the agents of a scene are sent along its trajectories over the action's server, at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.planning.analysis import apart_m, checks, load_results, measure_claims
from sfglab.lab.experiments.planning.config import Config
from sfglab.lab.experiments.planning.figure import figure_interpolation, figure_scene
from sfglab.lab.experiments.planning.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "apart_m",
    "checks",
    "figure_interpolation",
    "figure_scene",
    "figures",
    "load_results",
    "measure_claims",
    "run",
]

NAME = "planning"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {
        "planning_scene": figure_scene(results),
        "planning_interpolation": figure_interpolation(results),
    }
