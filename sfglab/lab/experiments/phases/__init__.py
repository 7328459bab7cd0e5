"""Phases: in which mode of publication, over which air and by which queue paper B's conclusions hold.

In each condition all is run that the criteria of B-LAT, B-LOSS and B-COOP compare (``data/claims.yaml``). Near
borders between unlike answers more conditions follow. The criteria's own are among them, so that a run judges.
"""

from sfglab.lab.experiments.phases.answers import ANSWERS
from sfglab.lab.experiments.phases.experiment import exp
from sfglab.lab.experiments.phases.verdicts import phases, shares

__all__ = ["ANSWERS", "exp", "phases", "shares"]
