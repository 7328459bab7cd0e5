"""Fleet discovery: paper A, sections 4.1, 4.2 and 5.3, Fig. 9.

Fleets of 2 to 6 agents are started by one signal. *Standard*: all nodes share one DDS domain. *Routed*: each
agent has its own, and its router lets through what Table 1 names. Measured is how long each agent takes to know
its peers, and what it receives until then. What one machine cannot carry is simulated.
"""

from sfglab.lab.experiments.discovery import simulated, stage
from sfglab.lab.experiments.discovery.analysis import live, summary
from sfglab.lab.experiments.discovery.experiment import Fleet, exp

__all__ = ["Fleet", "exp", "live", "simulated", "stage", "summary"]
