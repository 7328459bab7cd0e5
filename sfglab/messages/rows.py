"""Rows of measurement tables as ROS messages, so that any reader of a log can decode them.

The module turns a frozen dataclass into `sfglab_rows/msg/<ClassName>`. It does not depend on the place
where rows are written.
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from typing import Any

from sfglab.fields import field_docs
from sfglab.messages.store import MessageError, register

_PACKAGE = "sfglab_rows"
_TYPES = {bool: "bool", int: "int64", float: "float64", str: "string"}


def row_type(row_class: type[Any]) -> type[Any]:
    """Return the message type of a table's rows, `sfglab_rows/msg/<ClassName>`, and register it on first use.

    The documentation of the fields becomes comments of the definition.

    Args:
        row_class: A dataclass. Types of fields are int (as int64), float (float64), bool and str (string).

    Raises:
        MessageError: A field is of another type, or another row class has the name.
    """
    if not dataclasses.is_dataclass(row_class):
        raise MessageError(f"{row_class.__name__}: given this class, allowed: dataclasses")
    key: Any = row_class
    return _registered(key)


@functools.cache
def _registered(row_class: Any) -> type[Any]:
    name = row_class.__name__
    docs = field_docs(row_class)
    lines = []
    for field, hint in typing.get_type_hints(row_class).items():
        if hint not in _TYPES:
            allowed = "allowed: int, float, bool and str; use NaN or an empty text instead of None"
            raise MessageError(f"{name}.{field}: given {hint}, {allowed}")
        comment = f"  # {docs[field]}" if field in docs else ""
        lines.append(f"{_TYPES[hint]} {field}{comment}\n")
    return register(f"{_PACKAGE}/msg/{name}", "".join(lines))


def row_message(row: Any) -> Any:
    """Return one row as a message of its `row_type`, ready for `serialize`.

    Raises:
        MessageError: As for `row_type`.
    """
    message = row_type(type(row))
    values = {field.name: getattr(row, field.name) for field in dataclasses.fields(row)}
    return message(**values)
