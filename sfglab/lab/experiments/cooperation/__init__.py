"""Cooperation: paper B, section 3.2, Fig. 12 to 18.

Three robots drive a lap around a hallway. The robots send LIDAR values to a station, and it sends commands, over
one wireless channel. Laps are simulated for each method and rate, and one is driven live over DDS.
"""

from sfglab.lab.experiments.cooperation import drawn, live  # noqa: F401 - declare their parts
from sfglab.lab.experiments.cooperation.experiment import exp
from sfglab.lab.experiments.cooperation.explorer import hallway_lap
from sfglab.lab.experiments.cooperation.results import (
    difference,
    endings,
    laps,
)

__all__ = [
    "difference",
    "endings",
    "exp",
    "hallway_lap",
    "laps",
]
