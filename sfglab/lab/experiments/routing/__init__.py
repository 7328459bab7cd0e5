"""Traffic routing by the naming schema: paper A, section 4.1, Eq. 1 and Table 1.

Agents behind routers and two parties in the global domain use the same names: those of Table 1, local names and
near misses. The log has the number of messages that each party received from each other party, by name. The policy is
also checked by computation.
"""

from sfglab.lab.experiments.routing import live
from sfglab.lab.experiments.routing.experiment import exp
from sfglab.lab.experiments.routing.results import check_table, checks

__all__ = ["check_table", "checks", "exp", "live"]
