"""Rows of measurement tables as ROS messages, so that any reader of a log can decode them.

The module turns a frozen dataclass into `sfglab_rows/msg/<ClassName>`. It does not depend on the place
where rows are written.
"""

from __future__ import annotations

import dataclasses
import re
import typing
from collections.abc import Sequence
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sfglab.fields import field_docs
from sfglab.messages.store import MessageError, register

_PACKAGE = "sfglab_rows"
_SCALARS = {bool: "bool", int: "int64", float: "float64", str: "string"}
_ARRAY_KINDS = "biuf"
# rosidl's rules (rosidl_adapter, parser.py); other tools would refuse to read names that break them.
_CLASS_NAME = re.compile(r"[A-Z][A-Za-z0-9]*")
_FIELD_NAME = re.compile(r"[a-z](?:_?[a-z0-9]+)*")
# Annotations may use these names, although the module imports them for type checkers only.
_KNOWN = {"np": np, "NDArray": NDArray, "Sequence": Sequence}
_types: dict[type[Any], tuple[type[Any], dict[str, str]]] = {}


def _field_type(hint: Any, place: str) -> str:
    """Return the type of the interface language for an annotation."""
    if isinstance(hint, type) and hint in _SCALARS:
        return _SCALARS[hint]
    if (
        isinstance(hint, type)
        and issubclass(hint, Enum)
        and all(isinstance(e.value, str) for e in hint)
    ):
        return "string"
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple and arguments[1:] == (...,):
        arguments = arguments[:1]
    if origin in (list, tuple, Sequence) and len(arguments) == 1 and arguments[0] in _SCALARS:
        return f"{_SCALARS[arguments[0]]}[]"
    if origin is np.ndarray and (dtypes := typing.get_args(arguments[1])):
        dtype = np.dtype(dtypes[0]) if isinstance(dtypes[0], type) else None
        if dtype is not None and dtype.kind in _ARRAY_KINDS and dtype.itemsize <= 8:
            return f"{dtype.name}[]"
    raise MessageError(
        f"{place}: given {hint}, allowed are int, float, bool, str, text enums, list[...] and tuple[..., ...]"
        " of these, and NDArray of numbers; use NaN or an empty value instead of None"
    )


def _fields(row_class: type[Any]) -> dict[str, str]:
    """Return the types of the interface language for each field, by name."""
    name = row_class.__name__
    if not (dataclasses.is_dataclass(row_class) and _CLASS_NAME.fullmatch(name)):
        raise MessageError(
            f"{name}: given this class, allowed are dataclasses with a CamelCase name"
        )
    try:
        hints = typing.get_type_hints(row_class, localns=_KNOWN)
    except NameError as exc:
        raise MessageError(f"{name}: {exc}: annotations must be importable at run time") from exc
    fields = {}
    for field in dataclasses.fields(row_class):
        place = f"{name}.{field.name}"
        if not _FIELD_NAME.fullmatch(field.name):
            raise MessageError(f"{place}: allowed are names_like_this, with single underscores")
        fields[field.name] = _field_type(hints[field.name], place)
    if not fields:
        raise MessageError(f"{name}: a row needs at least one field")
    return fields


def _registered(row_class: type[Any]) -> tuple[type[Any], dict[str, str]]:
    if row_class not in _types:
        fields, docs = _fields(row_class), field_docs(row_class)
        lines = [
            f"{word} {n}" + (f"  # {docs[n]}" if n in docs else "") for n, word in fields.items()
        ]
        _types[row_class] = (
            register(f"{_PACKAGE}/msg/{row_class.__name__}", "\n".join(lines) + "\n"),
            fields,
        )
    return _types[row_class]


def row_type(row_class: type[Any]) -> type[Any]:
    """Return the message type of a table's rows, `sfglab_rows/msg/<ClassName>`, and register it on first use.

    The documentation of the fields becomes comments of the definition.

    Args:
        row_class: A dataclass. Types of fields are int (as int64), float (float64), bool, str, enums of text
            (string), and NumPy arrays of numbers. Lists and tuples of any length of these are allowed as well.

    Raises:
        MessageError: A field is of another type, a name is not allowed in a message, or another row class has
            it.
    """
    return _registered(row_class)[0]


def _value(value: Any, word: str) -> Any:
    if value is None:
        raise TypeError("use NaN or an empty value")
    if isinstance(value, Enum):
        return value.value
    if not word.endswith("[]"):
        return value
    base = word[:-2]
    if base == "string":
        return list(value)
    array, dtype = np.asarray(value), np.dtype(base)
    # An empty list has no kind; all other lists must not lose a fraction in the conversion.
    return np.zeros(0, dtype) if array.size == 0 else array.astype(dtype, "C", casting="same_kind")


def row_message(row: Any) -> Any:
    """Return one row as a message of its `row_type`, ready for `serialize`; arrays have one dimension.

    Raises:
        MessageError: As for `row_type`, or a value is None or an array of another kind.
    """
    message, fields = _registered(type(row))
    values = {}
    for name, word in fields.items():
        value = getattr(row, name)
        try:
            values[name] = _value(value, word)
        except TypeError as exc:
            place = f"{type(row).__name__}.{name}"
            raise MessageError(f"{place}: given {value!r}, allowed is {word}: {exc}") from exc
    return message(**values)
