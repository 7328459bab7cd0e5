"""Transfer: paper C, section 4, Fig. 5 to 7, and what follows for mapping.

How long a message takes over a software-mapped topic and through a gateway: by the model of the memory
interface, with its memory part in simulated hardware, and across processes. From which size on a gateway pays,
and node mapping against brute force.
"""

from sfglab.lab.experiments.transfer import figures, stage
from sfglab.lab.experiments.transfer.analysis import fit_meaning, live_table, memory_speed_ups
from sfglab.lab.experiments.transfer.experiment import exp

__all__ = ["exp", "figures", "fit_meaning", "live_table", "memory_speed_ups", "stage"]
