"""The experiment `driving` runs the driving application of paper C, section 6, Fig. 9.

A car drives round simulated towns, and all nodes of the application process the images of the car's camera. The
experiment times the node chain from image to command with the chain's shared topic in software and with a gateway,
by the memory model and live.
"""

from sfglab.lab.experiments.driving.experiment import exp
from sfglab.lab.experiments.driving.results import (
    chain_table,
    live_saving,
    part_table,
    saved_ms,
)

__all__ = ["chain_table", "exp", "live_saving", "part_table", "saved_ms"]
