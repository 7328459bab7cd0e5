"""What the view refuses, said in one sentence each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Iterable


class ViewError(SfglabError):
    """Anything that the view refuses or cannot do."""


class ContentError(ViewError, ValueError):
    """A message whose content contradicts itself; the next ones may be fine.

    Attributes:
        what: Which part of the message.
    """

    def __init__(self, what: str, *, given: object, allowed: str) -> None:
        self.what = what
        super().__init__(f"{what}: given {given}, allowed {allowed}")


class SettingError(ViewError, ValueError):
    """A value that a parameter, a policy or a budget does not take.

    Attributes:
        setting: Its name.
    """

    def __init__(self, setting: str, *, given: object, allowed: str) -> None:
        self.setting = setting
        super().__init__(f"{setting}: given {given!r}, allowed {allowed}")


class SessionError(ViewError, LookupError):
    """Something that a session does not have.

    Attributes:
        wanted: What was asked for.
    """

    def __init__(self, kind: str, wanted: str, known: Iterable[str]) -> None:
        self.wanted = wanted
        super().__init__(f"{kind}: given {wanted!r}, allowed: {', '.join(sorted(known)) or 'none'}")


class SourceError(ViewError, OSError):
    """A log that cannot be read."""


class SinkError(ViewError, OSError):
    """A place that what is shown cannot be sent to; nothing more is shown there."""
