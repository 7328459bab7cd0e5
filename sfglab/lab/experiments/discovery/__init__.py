"""Fleet discovery: paper A, sections 4.1, 4.2 and 5.3, Fig. 9.

Fleets of 2 to 6 agents with ten publishing and ten subscribing nodes each are started by one signal.
*Standard*: all nodes share one DDS domain. *Routed*: every agent has a domain of its own, and its router lets
through what Table 1 names. Measured is how long each agent takes to know all its peers, and what its interface
receives until then. Larger fleets are routed only, and beyond what one machine carries they are simulated.
"""

from sfglab.lab.experiments.discovery import simulated, stage
from sfglab.lab.experiments.discovery.analysis import live, summary
from sfglab.lab.experiments.discovery.experiment import Fleet, exp

__all__ = ["Fleet", "exp", "live", "simulated", "stage", "summary"]
