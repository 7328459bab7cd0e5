"""Motion capture and the tree of frames: paper A, section 4.5, Eq. 4 and Fig. 6.

Exact: both trees of Fig. 6, the one between, and the same for random robots; faults of cameras against the
known truth; and, beyond the paper, what an estimate of the offset is worth. Live: a robot with odometry of its
own, the bridge and a listener as processes on hosts of their own, the direct receiver beside them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.mocap.analysis import checks, errors, load_results, measure_claims, offsets
from sfglab.lab.experiments.mocap.config import Config
from sfglab.lab.experiments.mocap.figure import mocap_error, mocap_offset, mocap_trees
from sfglab.lab.experiments.mocap.run import run
from sfglab.lab.experiments.profiles import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = [
    "NAME",
    "Config",
    "ConfigError",
    "checks",
    "errors",
    "figures",
    "load_results",
    "measure_claims",
    "mocap_error",
    "mocap_offset",
    "mocap_trees",
    "offsets",
    "run",
]

NAME = "mocap"


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw every figure of a run.

    Args:
        log: The run's log.

    Returns:
        Figure and the numbers that it shows, by the figure's name.
    """
    results = load_results(log)
    return {
        "mocap_trees": mocap_trees(results),
        "mocap_error": mocap_error(results),
        "mocap_offset": mocap_offset(results),
    }
