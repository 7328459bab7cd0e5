"""Fleet discovery: paper A, sections 4.1, 4.2 and 5.3, Fig. 9.

One start order starts fleets of 2 to 6 agents. In mode *standard* all nodes share one DDS domain. In the modes
*launched* and *routed* each agent has its own domain behind a router. The experiment measures the time until an agent
has discovered its peers, and the bytes that it receives until then.
"""

from sfglab.lab.experiments.discovery import live  # it declares a part
from sfglab.lab.experiments.discovery.experiment import exp
from sfglab.lab.experiments.discovery.results import PAPERS_LARGEST, fleet_table, main_nodes

__all__ = ["PAPERS_LARGEST", "exp", "fleet_table", "live", "main_nodes"]
