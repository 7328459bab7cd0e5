"""Caches and balanced QoS: paper B, sections 2.2 to 2.4, Fig. 3 and 5, Eq. 1 to 6, Table 1.

What local cache and cache control hold back of the sensors' readings, what a lost change does and what a
longest silence does about it; the printed optimum by CVXPY and by hand, and our own problem with its Pareto
front.
"""

from sfglab.lab.experiments.balancing.analysis import saved, staleness
from sfglab.lab.experiments.balancing.experiment import exp

__all__ = ["exp", "saved", "staleness"]
