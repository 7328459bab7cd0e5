"""DDS and Zenoh between agents: an alternative that paper A names in its outlook.

Two ways over DDS behind routers, plain ROS 2, and Zenoh over a hub and between peers are compared: discovery of
fleets of processes, of up to 1,000 Zenoh sessions and by formula, and the cost of messages and images.
"""

from sfglab.lab.experiments.middleware import live  # noqa: F401 - it declares parts
from sfglab.lab.experiments.middleware.experiment import exp
from sfglab.lab.experiments.middleware.results import BEYOND, KINDS, NAMES, costs, fleets

__all__ = ["BEYOND", "KINDS", "NAMES", "costs", "exp", "fleets"]
