"""The experiment `gateways` explores the gateway core of paper C, sections 3 and 5, Fig. 4 and 8.

The experiment explores the state machine of the gateway core in every order of events up to a bound. The experiment
also maps the topics of the paper's example to software, hardware and gateways.
"""

from sfglab.lab.experiments.gateways.experiment import exp
from sfglab.lab.experiments.gateways.results import press_core

__all__ = ["exp", "press_core"]
