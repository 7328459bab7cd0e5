"""The experiment `balancing` has paper B's caches and balanced QoS: 2.2 to 2.4, Fig. 3 and 5, Eq. 1 to 6, Table 1.

The experiment shows which readings the local cache and cache control suppress, and computes the published optimum of
rate and depth.
"""

from sfglab.lab.experiments.balancing.experiment import exp
from sfglab.lab.experiments.balancing.results import cache_curves, channel_loads, check_table

__all__ = ["cache_curves", "channel_loads", "check_table", "exp"]
