"""Sweeps over points and seeds on local workers or a cluster, with the same rows in order."""

from sfglab.lab.sweep.journal import SweepError, journals
from sfglab.lab.sweep.run import Workers, sweep

__all__ = ["SweepError", "Workers", "journals", "sweep"]
