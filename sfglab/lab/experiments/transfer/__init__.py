"""Transfer: paper C, section 4, Fig. 5 to 7, and what follows for mapping.

How long a message takes over a software-mapped topic and through a gateway, from hardware or software to the
last hardware subscriber and to a software subscriber: by the model of the memory interface, with its memory
part in simulated hardware, and across processes on this machine. And from which size on a gateway is worth it,
what a mapping gains that knows sizes, and node mapping against brute force.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.transfer.analysis import (
    live_agreement,
    live_note,
    live_table,
    load_results,
    memory_speed_ups,
)
from sfglab.lab.experiments.transfer.claims import fit_meaning, measure_claims
from sfglab.lab.experiments.transfer.config import Config
from sfglab.lab.experiments.transfer.figure import figure_live, figure_transfer
from sfglab.lab.experiments.transfer.figure_beyond import figure_break_even, figure_residuals
from sfglab.lab.experiments.transfer.figure_placing import figure_node_mapping
from sfglab.lab.experiments.transfer.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "figure_break_even",
    "figure_live",
    "figure_node_mapping",
    "figure_residuals",
    "figure_transfer",
    "figures",
    "fit_meaning",
    "live_agreement",
    "live_note",
    "live_table",
    "load_results",
    "measure_claims",
    "memory_speed_ups",
    "run",
]

NAME = "transfer"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name; the live one only where something ran live.
    """
    results = load_results(log)
    drawn = {
        "transfer": figure_transfer(results),
        "transfer_residuals": figure_residuals(results),
        "transfer_break_even": figure_break_even(results),
        "node_mapping": figure_node_mapping(results),
    }
    if not results.live.empty:
        drawn["transfer_live"] = figure_live(results)
    return drawn
