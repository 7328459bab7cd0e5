"""Latency: paper A, section 5.4, Fig. 10.

Glass to glass, from a frame's capture to its decoded pixels in a viewer's hands, and from the order to
subscribe to the first picture: standard, through the decoder, and through routers and decoder; in the paper's
manner, where the decoder is loaded on demand and waits for a key frame, and with a warm spare and the sender's
replay.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.latency.analysis import checks, load_results, measure_claims
from sfglab.lab.experiments.latency.config import Config
from sfglab.lab.experiments.latency.figure import figure_10
from sfglab.lab.experiments.latency.run import run
from sfglab.lab.experiments.profiles import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "checks",
    "figure_10",
    "figures",
    "load_results",
    "measure_claims",
    "run",
]

NAME = "latency"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    return {"latency": figure_10(load_results(log))}
