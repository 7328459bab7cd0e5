"""Errors of logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from pathlib import Path


class LogExistsError(SfglabError, FileExistsError):
    """A log is to be written where a file is.

    Attributes:
        path: Where.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        super().__init__(f"log {path}: there is a file already; choose another path or pass overwrite=True")


class LogMissingError(SfglabError, FileNotFoundError):
    """A log is to be read where no file is.

    Attributes:
        path: Where.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        super().__init__(f"log {path}: no such file")


class LogFormatError(SfglabError, ValueError):
    """A file is not a log, or a damaged one.

    Attributes:
        path: Which file.
        reason: What is wrong with it.
    """

    def __init__(self, path: Path, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"log {path}: {reason}")


class LogLookupError(SfglabError, LookupError):
    """A log does not contain what was asked for.

    Attributes:
        name: What was asked for.
        present: What of that kind the log contains.
    """

    def __init__(self, kind: str, name: str, present: tuple[str, ...]) -> None:
        self.name = name
        self.present = present
        super().__init__(f"log: no {kind} {name!r}; there is {', '.join(present) or 'none at all'}")


class LogInputError(SfglabError, ValueError):
    """Something that cannot be written into a log, or asked of one."""


class LogClosedError(SfglabError, ValueError):
    """A log was used after it had been closed, or after a write had failed.

    Attributes:
        path: Which file.
    """

    def __init__(self, path: Path, *, failed: bool) -> None:
        self.path = path
        why = "an earlier write failed, so nothing more can follow it" if failed else "it is closed"
        super().__init__(f"log {path}: {why}")
