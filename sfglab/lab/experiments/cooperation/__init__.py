"""Cooperation: paper B, section 3.2, Fig. 12 to 18.

Three robots go around a hallway on what their LIDARs' messages tell a station and what its commands tell them.
How often they come home without contact and without a stop for an obstacle, by method and rate, simulated with
the reliability model of `sfglab.rtps` between the nodes; and the same nodes live over DDS.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.cooperation.analysis import (
    contrasts,
    difference,
    failures,
    load_results,
    measure_claims,
    rates,
    staleness,
)
from sfglab.lab.experiments.cooperation.animation import film, show_film
from sfglab.lab.experiments.cooperation.config import Config
from sfglab.lab.experiments.cooperation.figure import (
    figure_16,
    figure_17_18,
    figure_contrasts,
    figure_live,
    figure_staleness,
)
from sfglab.lab.experiments.cooperation.replay import write_rerun
from sfglab.lab.experiments.cooperation.run import run
from sfglab.lab.experiments.profiles import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "contrasts",
    "difference",
    "failures",
    "figure_16",
    "figure_17_18",
    "figure_contrasts",
    "figure_live",
    "figure_staleness",
    "figures",
    "film",
    "load_results",
    "measure_claims",
    "rates",
    "run",
    "show_film",
    "staleness",
    "write_rerun",
]

NAME = "cooperation"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    drawn = {
        "cooperation": figure_16(results),
        "cooperation_tracks": figure_17_18(results),
        "cooperation_staleness": figure_staleness(results),
    }
    more = {"cooperation_contrasts": figure_contrasts(results), "cooperation_live": figure_live(results)}
    return drawn | {name: figure for name, figure in more.items() if figure is not None}
