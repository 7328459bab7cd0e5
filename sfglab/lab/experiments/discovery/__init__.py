"""Fleet discovery: paper A, sections 4.1, 4.2 and 5.3, Fig. 9.

Fleets of 2 to 6 agents are started by one signal. *Standard*: all nodes share one DDS domain. *Launched*
and *routed*: each agent has its own domain behind a router. Measured are the time until an agent knows
its peers, and the bytes that it receives until then. Fleets of up to 25 agents are also simulated.
"""

from sfglab.lab.experiments.discovery import live, simulated  # they declare parts
from sfglab.lab.experiments.discovery.experiment import Fleet, exp
from sfglab.lab.experiments.discovery.results import (
    PAPERS_LARGEST,
    endpoints,
    fleet_table,
    main_nodes,
)

__all__ = [
    "PAPERS_LARGEST",
    "Fleet",
    "endpoints",
    "exp",
    "fleet_table",
    "live",
    "main_nodes",
    "simulated",
]
