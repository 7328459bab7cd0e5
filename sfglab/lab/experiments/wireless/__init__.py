"""Wireless: a radio with loss, bursts, a falling bit rate and outages, for DDS and Zenoh; paper A, sections 4.3 and 6.

The experiment measures the age of information at a station, the presence of agents in the fleet, and the frozen time of
a decoded H.264 stream.
"""

from sfglab.lab.experiments.wireless import live  # noqa: F401 - declares its parts
from sfglab.lab.experiments.wireless.experiment import exp
from sfglab.lab.experiments.wireless.results import NAMES, overview, ratio

__all__ = ["NAMES", "exp", "overview", "ratio"]
