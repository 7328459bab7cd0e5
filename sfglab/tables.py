"""Rows as aligned columns for a terminal, and as HTML for a notebook."""

from __future__ import annotations

import dataclasses
from html import escape
from typing import TYPE_CHECKING, Any

from sfglab.fields import field_docs, to_json

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

WIDTH = 110  #: Largest width of the line below the header, in characters.


def columns(rows: Iterable[Sequence[str]], *, right: Container[int] = ()) -> list[str]:
    """Return rows of texts as lines of aligned columns; columns whose positions are in `right` are flush right."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = []
        for i, (cell, width) in enumerate(zip(row, widths, strict=True)):
            cells.append(cell.rjust(width) if i in right else cell.ljust(width))
        lines.append("  ".join(cells).rstrip())
    return lines


def text_table(rows: Iterable[Sequence[str]]) -> str:
    """Return rows as aligned columns; the first row is the header."""
    lines = columns(rows)
    lines.insert(1, "-" * min(WIDTH, max(map(len, lines))))
    return "\n".join(f"  {line}" for line in lines)


_CELL = "white-space: normal; vertical-align: top"


def html_table(
    rows: Iterable[Sequence[object]], caption: str = "", *, right: Container[int] = ()
) -> str:
    """Return rows as an HTML table, with all texts escaped and in full; the first row is the header.

    Columns whose positions are in `right` are flush right.
    """
    lines: list[str] = []
    for row in rows:
        tag = "td" if lines else "th"
        line = ""
        for i, cell in enumerate(row):
            side = "right" if i in right else "left"
            line += f'<{tag} style="text-align: {side}; {_CELL}">{escape(str(cell))}</{tag}>'
        lines.append(f"<tr>{line}</tr>")
    head, *body = lines
    said = f'<caption style="text-align: left">{escape(caption)}</caption>' if caption else ""
    return f"<table>{said}<thead>{head}</thead><tbody>{''.join(body)}</tbody></table>"


class Shown:
    """Base class of dataclasses that a notebook shows as a table of fields, values and meanings."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        """Return the table."""
        return html_table(field_rows(self), type(self).__name__)


def field_rows(value: Any) -> list[tuple[str, str, str]]:
    """Return the fields of a dataclass with their values and documentation, after a header."""
    docs = field_docs(type(value))
    rows = [("field", "value", "meaning")]
    for field in dataclasses.fields(value):
        text = _text(to_json(getattr(value, field.name)))
        rows.append((field.name, text, docs.get(field.name, "")))
    return rows


def _text(value: Any) -> str:
    return ", ".join(map(_text, value)) if isinstance(value, list) else str(value)
