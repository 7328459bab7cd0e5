"""Heartbeats and the life cycle of remote agents: paper A, section 4.2, Fig. 3.

Status providers beat at the paper's periods; then a discoverer is led through every transition of its table by
real processes, stopped, killed and started again, and by false agents.
"""

from sfglab.lab.experiments.lifecycle.analysis import heartbeat_checks, intervals, transitions
from sfglab.lab.experiments.lifecycle.experiment import exp
from sfglab.lab.experiments.lifecycle.figures import press_lifecycle, press_states

__all__ = ["exp", "heartbeat_checks", "intervals", "press_lifecycle", "press_states", "transitions"]
