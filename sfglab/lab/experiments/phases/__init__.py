"""The experiment `phases` shows with which middleware, wireless channel and queues the conclusions of paper B hold.

The experiment simulates each condition with all methods and rates that the criteria of B-LAT, B-LOSS and B-COOP
compare (``data/claims.yaml``). The conditions of the criteria are among the conditions of the experiment, so the
ledger can judge a run.
"""

from sfglab.lab.experiments.phases.experiment import conditions, exp
from sfglab.lab.experiments.phases.results import ANSWERS, phases, press_map

__all__ = ["ANSWERS", "conditions", "exp", "phases", "press_map"]
