"""Rows as aligned columns for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence


WIDTH = 110
"""Of the line under the head, at most."""


def columns(rows: Iterable[Sequence[str]], *, right: Container[int] = ()) -> list[str]:
    """Return rows as lines of aligned columns; those whose positions are in `right` are flush right."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def text_table(rows: Iterable[Sequence[str]]) -> str:
    """Return rows as aligned columns; the first is the head."""
    lines = columns(rows)
    lines.insert(1, "-" * min(WIDTH, max(map(len, lines))))
    return "\n".join(f"  {line}" for line in lines)
