"""Phases: with which middleware, wireless channel and queues the conclusions of paper B hold.

In each condition everything is simulated that the criteria of B-LAT, B-LOSS and B-COOP compare
(``data/claims.yaml``). The conditions of the criteria are among them, so that a run is judged.
"""

from sfglab.lab.experiments.phases.experiment import conditions, exp
from sfglab.lab.experiments.phases.results import ANSWERS, phases, press_map, shares

__all__ = ["ANSWERS", "conditions", "exp", "phases", "press_map", "shares"]
