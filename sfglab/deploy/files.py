"""A file that a machine is given."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BundleFile"]

PLAIN = 0o644
PROGRAM = 0o755


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleFile:
    """A text file of an agent's folder.

    Attributes:
        text: What stands in it.
        mode: Its permissions, ``PLAIN`` or ``PROGRAM``.
    """

    text: str
    mode: int = PLAIN
