"""Warnings that are logged once: a sender of refused input must not fill the log."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import logging
    from collections.abc import Hashable

MAX_WARNINGS = 1000  #: Maximum number of different warnings.


class WarnOnce:
    """Warnings of one logger, each logged once per key."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._keys: set[Hashable] = set()

    def __call__(self, key: Hashable, sentence: str) -> None:
        """Log a warning, unless its key has been logged or the maximum is reached."""
        if key not in self._keys and len(self._keys) < MAX_WARNINGS:
            self._keys.add(key)
            self._log.warning("%s", sentence)
