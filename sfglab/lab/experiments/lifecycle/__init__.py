"""Heartbeats and the life cycle of remote agents: paper A, section 4.2, Fig. 3.

First, status providers beat at the paper's periods and a listener on another host takes the times. Then a
discoverer is led through every transition of its table, by real processes that are stopped, killed and started
again, and by false agents that are mute, late, changed, restarted, ill-formed and too many.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.lifecycle.analysis import Transitions, measure_claims, transitions
from sfglab.lab.experiments.lifecycle.beats import heartbeat_checks, intervals
from sfglab.lab.experiments.lifecycle.config import Config
from sfglab.lab.experiments.lifecycle.figure import draw_heartbeats
from sfglab.lab.experiments.lifecycle.results import Results, load_results
from sfglab.lab.experiments.lifecycle.run import run
from sfglab.lab.experiments.lifecycle.statechart import draw_states
from sfglab.lab.experiments.profiles import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "Results",
    "Transitions",
    "draw_heartbeats",
    "draw_states",
    "figures",
    "heartbeat_checks",
    "intervals",
    "load_results",
    "measure_claims",
    "run",
    "transitions",
]

NAME = "lifecycle"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {"heartbeats": draw_heartbeats(results), "discovery_states": draw_states(results)}
