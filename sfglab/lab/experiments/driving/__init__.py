"""Driving: paper C, section 6, Fig. 9.

A car goes round simulated towns by its camera, every node of the application real; the node chain from image to
command is timed with its shared topic in software and with a gateway, under the memory model.
"""

from sfglab.lab.experiments.driving.analysis import chain_table, node_table
from sfglab.lab.experiments.driving.experiment import exp
from sfglab.lab.experiments.driving.figures import film

__all__ = ["chain_table", "exp", "film", "node_table"]
