"""Decode once per device: paper A, sections 4.3 and 5.2, Fig. 8, Eq. 2 and 3.

An edge host sends a camera stream to a consumer host with 1 to 10 local subscribers. *Standard*: each
subscriber receives and decodes for itself. *Proxy*: the decoder receives and decodes once and shares the
pictures by shared memory. Measured are the consumer's CPU and what its interface receives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.decode_once.analysis import (
    cost_model,
    frame_checks,
    load_results,
    measure_claims,
    slopes,
    stream_facts,
)
from sfglab.lab.experiments.decode_once.config import Config, Stage
from sfglab.lab.experiments.decode_once.figure import figure_8
from sfglab.lab.experiments.decode_once.run import run
from sfglab.lab.experiments.profiles import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "Stage",
    "cost_model",
    "figure_8",
    "figures",
    "frame_checks",
    "load_results",
    "measure_claims",
    "run",
    "slopes",
    "stream_facts",
]

NAME = "decode_once"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {f"decode_once_{codec}": figure_8(results, codec) for codec in results.codecs}
