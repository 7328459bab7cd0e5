"""The bridge to the Rerun viewer: paper A, section 4.5.

A scene in which a fleet says everything that a visualizer of the list can show is shown from a log and, sent by
another process, from the bus; what the recordings hold is compared with what was said. Displays are added,
tuned and removed while pictures come; streams are synchronised against the truth; depth becomes points beside
an independent back-projection. What the bridge adds to a picture's way is timed against Rerun's own call, and
what waits is watched while the sink stands still.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.visualisation.analysis import (
    added_ms,
    checks,
    latency_table,
    load_results,
    measure_claims,
)
from sfglab.lab.experiments.visualisation.config import Config
from sfglab.lab.experiments.visualisation.figure import figure_latency, figure_points
from sfglab.lab.experiments.visualisation.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "added_ms",
    "checks",
    "figure_latency",
    "figure_points",
    "figures",
    "latency_table",
    "load_results",
    "measure_claims",
    "run",
]

NAME = "visualisation"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {
        "visualisation_latency": figure_latency(results),
        "visualisation_points": figure_points(results, log),
    }
