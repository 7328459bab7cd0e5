"""The experiment `transfer` has the transfer times of paper C, section 4, Fig. 5 to 7.

The experiment shows how long a message takes over a software-mapped topic and through a gateway: by the memory
model, with the cycles of simulated hardware, and live between processes.
"""

from sfglab.lab.experiments.transfer import live  # noqa: F401 - declares its part
from sfglab.lab.experiments.transfer.experiment import exp
from sfglab.lab.experiments.transfer.results import (
    constants,
    live_bars,
    prediction_table,
    stated,
    transfer_curves,
)

__all__ = [
    "constants",
    "exp",
    "live_bars",
    "prediction_table",
    "stated",
    "transfer_curves",
]
