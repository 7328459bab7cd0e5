"""What can go wrong with a sweep."""

from __future__ import annotations

from sfglab.errors import SfglabError


class SweepError(SfglabError, RuntimeError):
    """A sweep that cannot be run, or whose task failed.

    Attributes:
        point: Of the failed task; None when it was not a task that failed.
        seed: Of the failed task; None as above.
    """

    def __init__(self, message: str, *, point: object = None, seed: int | None = None) -> None:
        self.point = point
        self.seed = seed
        super().__init__(message)


class JournalError(SfglabError, OSError):
    """A file that cannot serve as a sweep's journal."""
