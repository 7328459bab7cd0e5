"""Deployment: paper A, section 4.4, Fig. 5.

The paper's test bed is made into all files of its machines; these are checked, brought to folders in place of
machines and taken back; hooks are run; containers' commands are run between namespaces; an image is built.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.deployment.analysis import Results, load_results, measure_claims, text_of
from sfglab.lab.experiments.deployment.config import Config
from sfglab.lab.experiments.deployment.figure import figure_checks, figure_layers
from sfglab.lab.experiments.deployment.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "Results",
    "figure_checks",
    "figure_layers",
    "figures",
    "load_results",
    "measure_claims",
    "run",
    "text_of",
]

NAME = "deployment"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {"deployment_layers": figure_layers(results), "deployment_checks": figure_checks(results)}
