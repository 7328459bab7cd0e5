"""Phases: in which mode of publication, over which air and by which queue paper B's conclusions hold.

In each condition `transmission`'s scenario, with the hop over robot 3's machine, is run with every method and
depth that the criteria of B-LAT and B-LOSS compare (``data/claims.yaml``), and `cooperation`'s hallway driven.
Near the borders between unlike answers more conditions follow. The criteria's own conditions are among them, so
that a run judges the three claims.
"""

from __future__ import annotations

from sfglab.lab.experiments.phases.answers import ANSWERS
from sfglab.lab.experiments.phases.experiment import exp
from sfglab.lab.experiments.phases.verdicts import phases, shares

__all__ = ["ANSWERS", "exp", "phases", "shares"]
