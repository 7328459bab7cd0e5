"""Errors of the view, said in one sentence each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError, SfglabError

if TYPE_CHECKING:
    from collections.abc import Iterable


class ViewError(SfglabError):
    """Anything that the view refuses or cannot do."""


class ContentError(ViewError, InvalidValueError):
    """A message whose content contradicts itself; the next ones may be fine."""


class SettingError(ViewError, InvalidValueError):
    """A value that a parameter, a policy or a budget does not take."""


class SessionError(ViewError, InvalidValueError):
    """Something that a session does not have."""

    def __init__(self, kind: str, wanted: str, known: Iterable[str]) -> None:
        super().__init__(kind, wanted, ", ".join(sorted(known)) or "none")


class SourceError(ViewError, OSError):
    """A log that cannot be read."""


class SinkError(ViewError, OSError):
    """A place that what is shown cannot be sent to; nothing more is shown there."""
