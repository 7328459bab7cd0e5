"""Caches and balanced QoS: paper B, sections 2.2 to 2.4, Fig. 3 and 5, Eq. 1 to 6, Table 1.

What the caches hold back, what a lost change does, the printed optimum, and our own problem's Pareto front.
"""

from sfglab.lab.experiments.balancing.analysis import saved, staleness
from sfglab.lab.experiments.balancing.experiment import exp

__all__ = ["exp", "saved", "staleness"]
