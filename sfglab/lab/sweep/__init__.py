"""Configurations by seeds, spread over workers: the same rows in the same order wherever they ran."""

from sfglab.lab.sweep.journal import JournalError, SweepError, journals
from sfglab.lab.sweep.run import Workers, sweep

__all__ = ["JournalError", "SweepError", "Workers", "journals", "sweep"]
