"""Traffic routing by the naming schema: paper A, section 4.1, Eq. 1 and Table 1.

Agents behind routers and two parties in the global domain use the same names: those of Table 1, local ones and
near misses. The log holds who heard what of whom; beside that the policy is checked exactly.
"""

from sfglab.lab.experiments.routing import live
from sfglab.lab.experiments.routing.experiment import exp
from sfglab.lab.experiments.routing.results import check_table, checks

__all__ = ["check_table", "checks", "exp", "live"]
