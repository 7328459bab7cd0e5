"""Motion capture and TF trees: paper A, section 4.5, Eq. 4 and Fig. 6.

The trees of Fig. 6 and of random robots are computed. In the live run robot, bridge and listener are on
hosts of their own; the direct receiver runs beside the bridge.
"""

from sfglab.lab.experiments.mocap.experiment import exp
from sfglab.lab.experiments.mocap.results import check_table, checks

__all__ = ["check_table", "checks", "exp"]
