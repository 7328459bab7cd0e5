"""The root of every error that sfglab raises on purpose.

Specific errors live beside the code that raises them, derive from `SfglabError` and from the built-in
that fits, and keep the offending data as attributes. A message says where, what was given and what is
allowed or what to try.
"""

from __future__ import annotations

__all__ = ["MissingExtraError", "SfglabError"]


class SfglabError(Exception):
    """Anything that sfglab refuses or cannot do, said in one sentence."""


class MissingExtraError(SfglabError, ImportError):
    """An optional library is not installed.

    Attributes:
        library: The import name of what is missing.
        extra: The extra of sfglab that brings it.
    """

    def __init__(self, library: str, *, extra: str, purpose: str) -> None:
        self.library = library
        self.extra = extra
        super().__init__(f"{purpose} needs {library!r}, which is not installed: pip install 'sfglab[{extra}]'")
