"""How an exact experiment writes down what it checked: one row a property."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CheckRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckRow:
    """How often one property was checked and how often it held.

    Attributes:
        check: The property.
        checked: Cases it was checked on.
        held: Cases in which it held.
        example: A case in which it did not; else one in which it did.
    """

    check: str
    checked: int
    held: int
    example: str
