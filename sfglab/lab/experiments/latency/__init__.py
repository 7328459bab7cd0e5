"""Latency: paper A, section 5.4, Fig. 10.

The experiment measures the age of an image when a subscriber receives it, and the time from the order to subscribe to
the first image. It compares plain ROS 2, the paper's decoder behind two routers, and the sfglab variant.
"""

from sfglab.lab.experiments.latency import live  # noqa: F401 - declares its part
from sfglab.lab.experiments.latency.experiment import exp
from sfglab.lab.experiments.latency.results import (
    NAMES,
    added,
    checks,
    first_ratio,
    loading,
)

__all__ = ["NAMES", "added", "checks", "exp", "first_ratio", "loading"]
