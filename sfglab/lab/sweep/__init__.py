"""Configurations by seeds, spread over workers: the same rows in the same order wherever they ran.

Bottom up: `errors`, `rows` (rows as text and back), `identity` (which task, which points, which code),
`journal` (what is finished, on disk), `batch` (what a worker does), `workers` (local ones, or a cluster),
`run` (`sweep`).
"""

from __future__ import annotations

from sfglab.lab.sweep.errors import JournalError, SweepError
from sfglab.lab.sweep.journal import journals
from sfglab.lab.sweep.run import sweep
from sfglab.lab.sweep.workers import Workers

__all__ = ["JournalError", "SweepError", "Workers", "journals", "sweep"]
