"""Refusals that are said once each: whoever sends what is refused must not fill the log with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import logging
    from collections.abc import Hashable

MAX_SAID = 1000  #: How many different things are said at most.


class SaidOnce:
    """Warnings of one log, of which each is given once, by its key."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._said: set[Hashable] = set()

    def __call__(self, key: Hashable, sentence: str) -> None:
        """Say a sentence, unless its key has been said or too much has."""
        if key not in self._said and len(self._said) < MAX_SAID:
            self._said.add(key)
            self._log.warning("%s", sentence)
