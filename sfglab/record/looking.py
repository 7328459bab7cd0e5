"""Messages to look at: their fields by name, arrays by their shape, and one number out of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sfglab.messages.text import STEP
from sfglab.record.metadata import LogError
from sfglab.tables import html_table

if TYPE_CHECKING:
    from collections.abc import Iterator

_LONG = 8


class ShownMessage(NamedTuple):
    """A message, with its fields for people; `message` is the message itself."""

    topic: str
    type_name: str
    message: Any

    def __repr__(self) -> str:
        lines = (f"  {name}: {value}" for name, value in fields_of(self.message))
        return "\n".join((f"{self.topic} ({self.type_name})", *lines))

    def _repr_html_(self) -> str:
        return html_table(
            [("field", "value"), *fields_of(self.message)], f"{self.topic} ({self.type_name})"
        )


def fields_of(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Yield the fields of a message, nested ones by their way from the top, with values as text."""
    if hasattr(value, "__msgtype__"):
        for key, inner in vars(value).items():
            if key != "__msgtype__":
                yield from fields_of(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
        for number, inner in enumerate(value[:_LONG]):
            yield from fields_of(inner, f"{name}[{number}]")
        if len(value) > _LONG:
            yield f"{name}[...]", f"{len(value)} in all"
    elif isinstance(value, np.ndarray) and value.size > _LONG:
        ends = f", {value.min():.6g} to {value.max():.6g}" if value.dtype.kind in "iuf" else ""
        yield name, f"{value.size} x {value.dtype}{ends}"
    else:
        yield name, str(value.tolist() if isinstance(value, np.ndarray) else value)


def number_in(message: Any, field: str, place: str) -> float:
    """Return the number at a way as ``pose.position.x`` or ``ranges[0]``; LogError names what is there."""
    found = message
    try:
        for name, index in STEP.findall(field):
            found = getattr(found, name) if name else found[int(index)] if index else found
        return float(found)
    except (AttributeError, IndexError, TypeError, ValueError) as error:
        there = ", ".join(name for name, _ in fields_of(message))
        raise LogError(f"{place}: field: given {field!r}, allowed: a number of {there}") from error
