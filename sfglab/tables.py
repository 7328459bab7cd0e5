"""Rows as aligned columns for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


WIDTH = 110
"""Of the line under the head, at most."""


def text_table(rows: Iterable[Sequence[str]]) -> str:
    """Return rows as aligned columns; the first is the head."""
    head, *body = rows
    widths = [max(len(row[i]) for row in (head, *body)) for i in range(len(head))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in (head, *body)]
    lines.insert(1, "-" * min(WIDTH, max(map(len, lines))))
    return "\n".join(f"  {line}" for line in lines)
