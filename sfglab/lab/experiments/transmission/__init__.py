"""Transmission: paper B, section 3.1, Tables 1 and 2, Fig. 8 to 11.

Three robots send what their sensors say to the station, and "Hello" goes from robot 1 through the station back
to robot 1: latency and loss for every rate, depth and method, and where each lost "Hello" was lost.
"""

from sfglab.lab.experiments.transmission import figures, validation
from sfglab.lab.experiments.transmission.analysis import agreement, compare_ways, order
from sfglab.lab.experiments.transmission.experiment import exp, grid
from sfglab.lab.experiments.transmission.validation import on_ros2
from sfglab.lab.explore.timeline import Timeline

__all__ = [
    "Timeline",
    "agreement",
    "compare_ways",
    "exp",
    "figures",
    "grid",
    "on_ros2",
    "order",
    "validation",
]
