"""Phases: with which middleware, wireless channel and queues the conclusions of paper B hold.

Each condition is simulated with all methods and rates that the criteria of B-LAT, B-LOSS and B-COOP compare
(``data/claims.yaml``). The conditions of the criteria are among them, so that a run is judged.
"""

from sfglab.lab.experiments.phases.experiment import conditions, exp
from sfglab.lab.experiments.phases.results import ANSWERS, phases, press_map

__all__ = ["ANSWERS", "conditions", "exp", "phases", "press_map"]
