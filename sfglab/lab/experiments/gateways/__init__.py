"""Gateways: paper C, sections 3 and 5, Fig. 4 and 8.

The state machine of the gateway core is explored in every order of events up to a bound, and the paper's example
is mapped to software, hardware and gateways.
"""

from sfglab.lab.experiments.gateways.experiment import exp
from sfglab.lab.experiments.gateways.results import press_core

__all__ = ["exp", "press_core"]
