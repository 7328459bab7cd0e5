"""Base class of the errors that sfglab raises on purpose.

Specific errors are in the modules that raise them, and derive from a built-in error as well. A message names the
place, the given value, and the allowed values or a remedy.
"""

from __future__ import annotations

from os import PathLike, fspath
from typing import Any

KeyPath = tuple[str | int, ...]  #: Keys and list positions from the top of a document.
_SHOWN = 500  #: Characters of a long value's beginning and end that a message shows.


class SfglabError(Exception):
    """An error with a message of one sentence."""


class InvalidValueError(SfglabError, ValueError):
    """A value that is not allowed where it was given."""

    def __init__(self, place: Any, given: object, allowed: str) -> None:
        #: A field, an argument, an option, a key or a path of keys; a document's `sfglab.documents.Place`.
        self.place = place
        self.given = given  #: Given value; None if the value is missing.
        self.allowed = allowed  #: Allowed values, in words.
        # All arguments, so that the error survives pickling.
        super().__init__(place, given, allowed)

    def __str__(self) -> str:
        place = key_text(self.place) if isinstance(self.place, tuple) else self.place
        return f"{place}: {_said(self.given)}: {self.allowed}"


def key_text(path: KeyPath) -> str:
    """Return a path of keys as text, as in ``agents.go2.publishes[2]``."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}" if text else part
    return text


def _said(given: object) -> str:
    if isinstance(given, Exception):
        return f"{why(given)}, needed"
    return "nothing is given, needed" if given is None else f"given {_shown(given)}, allowed"


def why(error: Exception) -> str:
    """Return the cause of an error about a file as a phrase, without error number and file name."""
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start} is not {error.encoding.upper()}"
    reason = (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
    return reason[:1].lower() + reason[1:]


def _shown(given: object) -> str:
    """Return a value as text, cut in the middle. This does not fail for any value."""
    try:
        text = repr(fspath(given) if isinstance(given, PathLike) else given)
    # An integer of more digits than Python writes, or a value that is nested too deeply.
    except (ValueError, RecursionError):
        return f"a {type(given).__name__} that cannot be displayed"
    return text if len(text) <= 2 * _SHOWN else f"{text[:_SHOWN]} ... {text[-_SHOWN:]}"


class MissingExtraError(SfglabError, ImportError):
    """An optional library is not installed."""

    def __init__(self, library: str, *, extra: str, purpose: str) -> None:
        self.library = library  #: Import name of the missing library.
        self.extra = extra  #: Extra of sfglab that installs the library.
        super().__init__(
            f"{purpose} needs {library!r}, which is not installed; run pip install '.[{extra}]' in a checkout"
        )
