"""Sweeps over points and seeds on local workers or a cluster, with the same rows in order."""

from sfglab.lab.sweep.journal import JournalError, SweepError, journals
from sfglab.lab.sweep.run import Workers, sweep

__all__ = ["JournalError", "SweepError", "Workers", "journals", "sweep"]
