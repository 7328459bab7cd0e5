"""Heartbeats and the life cycle of remote agents: paper A, section 4.2, Fig. 3.

Status providers send heartbeats at the paper's periods. Then a real process, which is stopped, killed and started
again, and simulated agents lead a discoverer through the transitions of its table.
"""

from sfglab.lab.experiments.lifecycle import live  # noqa: F401 - declares its parts
from sfglab.lab.experiments.lifecycle.experiment import exp
from sfglab.lab.experiments.lifecycle.results import (
    heartbeat_checks,
    intervals,
    press_lifecycle,
    press_states,
    transitions,
)

__all__ = [
    "exp",
    "heartbeat_checks",
    "intervals",
    "press_lifecycle",
    "press_states",
    "transitions",
]
