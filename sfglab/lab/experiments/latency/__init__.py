"""Latency: paper A, section 5.4, Fig. 10.

The age of a picture when a subscriber holds it, and the time from the order to subscribe to the first
picture. Compared are standard ROS 2, the paper's decoder behind two routers, and sfglab's variant.
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
