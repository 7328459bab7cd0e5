"""Cooperation: paper B, section 3.2, Fig. 12 to 18.

Three robots go around a hallway on what messages tell a station and its commands tell them: how often they come
home, by method and rate, simulated with the reliability model of `sfglab.rtps`, and live over DDS.
"""

from sfglab.lab.experiments.cooperation.analysis import (
    courses,
    difference,
    failures,
    rates,
    staleness,
)
from sfglab.lab.experiments.cooperation.experiment import exp
from sfglab.lab.experiments.cooperation.figures import film
from sfglab.lab.experiments.cooperation.replay import Replay

__all__ = ["Replay", "courses", "difference", "exp", "failures", "film", "rates", "staleness"]
