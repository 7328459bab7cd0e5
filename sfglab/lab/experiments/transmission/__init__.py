"""The experiment `transmission` has paper B, section 3.1, Tables 1 and 2, Fig. 8 to 11.

Three robots send sensor readings to the station, and "Hello" goes from robot 1 through the station back to robot 1.
The experiment gives latency and loss for every rate, depth and method, with the frames that fill the channel.
"""

from sfglab.lab.experiments.transmission.experiment import exp
from sfglab.lab.experiments.transmission.results import causes, compared, validated
from sfglab.lab.explore.timeline import Timeline

__all__ = ["Timeline", "causes", "compared", "exp", "validated"]
