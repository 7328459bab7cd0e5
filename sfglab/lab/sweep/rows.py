"""A task's result as text and back, exactly: one row or a tuple of rows, each a flat dataclass. Pure.

A float is written as the shortest text that gives the same float again; NaN and infinities have names. Every
result passes through here, those that ran in this very process too, so that none of them differs.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any

import numpy as np

from sfglab.lab.sweep.errors import SweepError

_PLAIN = (bool, int, float, str, type(None))


def text_from_result(result: object) -> str:
    """Return a result as one line of JSON.

    Args:
        result: A row, a mapping by column, or a tuple of them; NumPy's scalars become Python's.

    Raises:
        SweepError: It is something else.
    """
    if isinstance(result, tuple):
        return json.dumps([_packed(row) for row in result])
    return json.dumps(_packed(result))


def result_from_text(text: str) -> Any:
    """Return what `text_from_result` was given.

    Args:
        text: From `text_from_result`.
    """
    packed = json.loads(text)
    return tuple(map(_unpacked, packed)) if isinstance(packed, list) else _unpacked(packed)


def _packed(row: object) -> dict[str, object]:
    if isinstance(row, Mapping):
        return {"columns": {str(name): _plain(dict, str(name), value) for name, value in row.items()}}
    if isinstance(row, type) or not is_dataclass(row):
        raise SweepError(f"result: given {row!r}, needed is a row (a dataclass) or a tuple of rows")
    kind = type(row)
    values = [_plain(kind, field.name, getattr(row, field.name)) for field in fields(row)]
    return {"row": f"{kind.__module__}:{kind.__qualname__}", "values": values}


def _plain(kind: type, name: str, value: object) -> object:
    if isinstance(value, np.generic):
        value = value.item()
    if type(value) not in _PLAIN:
        allowed = "bool, int, float, str and None"
        raise SweepError(
            f"row {kind.__qualname__}: {name}: given a {type(value).__name__}, allowed are {allowed}"
        )
    return value


def _unpacked(packed: dict[str, Any]) -> Any:
    if "columns" in packed:
        return packed["columns"]
    module, _, name = packed["row"].partition(":")
    kind: Any = sys.modules[module] if module in sys.modules else import_module(module)
    for part in name.split("."):
        kind = getattr(kind, part)
    names = [field.name for field in fields(kind)]
    return kind(**dict(zip(names, packed["values"], strict=True)))
