"""A file that a machine is given."""

from __future__ import annotations

from dataclasses import dataclass

PLAIN = 0o644
PROGRAM = 0o755


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleFile:
    """A text file of an agent's folder."""

    text: str  #: What stands in it.
    mode: int = PLAIN  #: Its permissions, ``PLAIN`` or ``PROGRAM``.
