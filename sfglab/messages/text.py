"""Messages as YAML, in the form that ROS 2's tools print and read.

The module depends on fields and their values only.
"""

from __future__ import annotations

import re
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.messages.store import EMPTY, default_message, fields_of, stamp_from_ns

if TYPE_CHECKING:
    from sfglab.messages.field_types import FieldType

#: One step of a path to a value: a name, a number in brackets, or a dot.
STEP = re.compile(r"(\w+)|\[(\d+)\]|\.")
_HEADER, _TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"


def values_of(message: Any, most: int | None = None) -> dict[str, Any]:
    """Return a message as plain values: mappings, lists, numbers and strings.

    Strings and arrays that are longer than `most` are cut; None cuts none.
    """
    types = _types_of(message.__msgtype__)
    return {name: _plain(getattr(message, name), type_, most) for name, type_ in types.items()}


def _types_of(type_name: str) -> dict[str, FieldType]:
    """Return the types of a message's fields, without the octet that stands for an empty message's fields."""
    types = fields_of(type_name)
    return {name: type_ for name, type_ in types.items() if name != EMPTY}


def _plain(value: Any, type_: FieldType, most: int | None) -> Any:
    if hasattr(value, "__msgtype__"):
        return values_of(value, most)
    if isinstance(value, str):
        return value if most is None or len(value) <= most else value[:most] + "..."
    if not isinstance(value, (list, np.ndarray)):
        return value
    kept = value if most is None else value[:most]
    if isinstance(kept, np.ndarray):  # rosbags reads bytes as signed numbers
        items = kept.astype(type_.dtype, copy=False).tolist()
    else:
        items = [_plain(one, type_, most) for one in kept]
    return items if len(kept) == len(value) else [*items, "..."]


def to_yaml(values: Any) -> str:
    """Return values of a message, or one of them, in the form of ROS 2's tools, with a line break at the end."""
    import yaml

    text: str = yaml.dump(values, allow_unicode=True, width=sys.maxsize, sort_keys=False)
    return text.removesuffix("...\n")  # YAML's end mark after a single value


def value_at(values: Any, way: str, place: str) -> Any:
    """Return the value at a path of names and numbers, such as ``pose.position.x`` or ``ranges[0]``.

    Raises:
        InvalidValueError: The path leads to no value; the error lists the names that exist.
    """
    found = values
    for name, index in STEP.findall(way):
        try:
            found = found[name or int(index)] if name or index else found
        except (KeyError, IndexError, TypeError) as error:
            there = found if isinstance(found, dict) else ["none"]
            if isinstance(found, list) and found:
                there = [f"[0] to [{len(found) - 1}]"]
            allowed = f"an existing field: {', '.join(there)}"
            raise InvalidValueError(place, way, allowed) from error
    return found


def message_from_yaml(type_name: str, text: str, place: str) -> Any:
    """Return a message with the fields of a YAML text; ``now`` stands for the time, ``auto`` for a header with it.

    Raises:
        InvalidValueError: The text is no YAML, or its values are not those of the type.
        UnknownTypeError: There is no such type.
    """
    import yaml

    try:
        values = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InvalidValueError(place, text, "YAML, such as '{data: hello}'") from error
    return _message(type_name, {} if values is None else values, place)


def _message(type_name: str, values: Any, place: str) -> Any:
    message = default_message(type_name)
    if (type_name, values) in ((_TIME, "now"), (_HEADER, "auto")):
        now = stamp_from_ns(time.time_ns())
        if type_name == _TIME:
            return now
        message.stamp, values = now, {}
    types = _types_of(type_name)
    allowed = ", ".join(types) or "no field"
    if not isinstance(values, dict):
        raise InvalidValueError(place, values, f"fields in braces: {allowed}")
    for name, value in values.items():
        if name not in types:
            raise InvalidValueError(place, name, allowed)
        setattr(message, name, _read(value, types[name], f"{place}: {name}"))
    return message


def _read(value: Any, type_: FieldType, place: str) -> Any:
    if not type_.is_list:
        return _read_one(value, type_, place)
    length = type_.length
    if type_.is_array:
        allowed = f"a list of {length} values"
        fits = isinstance(value, list) and len(value) == length
    else:
        allowed = f"a list of up to {length} values" if length else "a list of values"
        fits = isinstance(value, list) and not 0 < length < len(value)
    if not fits:
        raise InvalidValueError(place, value, allowed)
    items = [_read_one(one, type_, f"{place}[{number}]") for number, one in enumerate(value)]
    return np.array(items, type_.dtype) if type_.is_number else items


def _read_one(value: Any, type_: FieldType, place: str) -> Any:
    if type_.is_message:
        return _message(type_.base, value, place)
    if type_.is_number:
        return _number(value, type_.dtype, place)
    longest = type_.longest
    if isinstance(value, (dict, list)) or value is None or 0 < longest < len(str(value)):
        allowed = f"text of up to {longest} characters" if longest else "text"
        raise InvalidValueError(place, value, allowed)
    return str(value)


def _number(value: Any, dtype: np.dtype[Any], place: str) -> bool | int | float:
    if dtype.kind == "b":
        if not isinstance(value, bool):
            raise InvalidValueError(place, value, "true or false")
        return value
    if dtype.kind == "f":
        try:
            return float(None if isinstance(value, bool) else value)  # type: ignore[arg-type]  # TypeError
        except (TypeError, ValueError, OverflowError) as error:
            raise InvalidValueError(place, value, "a number") from error
    low, high = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise InvalidValueError(place, value, f"a whole number from {low} to {high}")
    return value
