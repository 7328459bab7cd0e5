"""Configurations by seeds, spread over workers: the same rows in the same order wherever they ran."""

from sfglab.lab.sweep.journal import JournalError, SweepError, journal_of, journals
from sfglab.lab.sweep.run import Workers, sweep

__all__ = ["JournalError", "SweepError", "Workers", "journal_of", "journals", "sweep"]
