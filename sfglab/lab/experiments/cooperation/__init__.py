"""The experiment `cooperation` has the hallway of paper B, section 3.2, Fig. 12 to 18.

Three robots drive a lap around a hallway. The robots send LIDAR values to a station, and the station sends commands,
over one wireless channel. The experiment simulates laps for each method and rate, and drives one lap live over DDS.
"""

from sfglab.lab.experiments.cooperation import drawn, live  # noqa: F401 - declare their parts
from sfglab.lab.experiments.cooperation.experiment import exp
from sfglab.lab.experiments.cooperation.explorer import hallway_lap
from sfglab.lab.experiments.cooperation.results import (
    depth_text,
    difference,
    endings,
    laps,
)

__all__ = [
    "depth_text",
    "difference",
    "endings",
    "exp",
    "hallway_lap",
    "laps",
]
