"""Reading of given values as typed fields by pydantic; each mistake becomes one of our errors.

Types and bounds stand in dataclasses (`sfglab.fields`). Pydantic is imported when something is read, since
it takes 0.1 s. The words for allowed values come from the JSON Schema of the type.
How strictly it is read depends on the `Source`: people's keys must be known, logs may be of another version.
"""

from __future__ import annotations

import math
from difflib import get_close_matches
from functools import cache
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, KeyPath, key_text
from sfglab.fields import Bounds
from sfglab.schema import Schema, Source, core_of, json_schema

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from pydantic_core import ErrorDetails, SchemaValidator

_UNKNOWN = ("unexpected_keyword_argument", "is_instance_of")
"""Pydantic's words for an unknown key; a `sfglab.documents.Place` has none."""
_PLAIN_WORDS = {
    "integer": "a whole number",
    "number": "a finite number",
    "string": "a text",
    "boolean": "true or false",
    "array": "a list",
    "object": "a mapping of keys to values",
    "null": "nothing",
}


def suggestion(word: object, known: Iterable[str], meant: str = "mean") -> str:
    """Return ``; did you mean 'x'?`` for the closest known word, or nothing when none is close."""
    close = get_close_matches(str(word), list(known), n=1, cutoff=0.6)
    return f"; did you {meant} {close[0]!r}?" if close else ""


def read(hint: Any, value: Any, about: str = "", source: Source = Source.VALUES) -> Any:
    """Return a value as a type, or raise an `InvalidValueError` that names the key after `about`."""

    def refuse(path: KeyPath, given: object, allowed: str) -> InvalidValueError:
        return InvalidValueError(f"{about}{key_text(path)}", given, allowed)

    return read_from(source, hint, value, refuse)


def read_from(
    source: Source, hint: Any, value: Any, refuse: Callable[[KeyPath, object, str], Exception]
) -> Any:
    """Return a value as a type, or raise what `refuse` makes of a mistake.

    It is given path and value of the first of the deepest mistakes, and what is allowed there:
    alternatives are refused together, and the one that was meant is refused deeper inside.
    """
    from pydantic import ValidationError

    try:
        return _validator(hint, source).validate_python(value)
    except ValidationError as error:
        schema = json_schema(hint, source)
        raise refuse(*_mistake(error.errors(include_url=False), value, schema)) from error


@cache
def _validator(hint: Any, source: Source) -> SchemaValidator:
    from pydantic_core import SchemaValidator

    return SchemaValidator(core_of(hint, source))


def _mistake(
    mistakes: list[ErrorDetails], value: Any, schema: Schema
) -> tuple[KeyPath, object, str]:
    """Return path and value of the first of the deepest mistakes, and what is allowed there."""
    paths = [_path(mistake, value) for mistake in mistakes]
    path = max(paths, key=len)
    mistake = mistakes[paths.index(path)]
    own = mistake.get("ctx", {}).get("error")
    if isinstance(own, InvalidValueError):
        return path, own.given, own.allowed
    key = path[-1] if path else ""
    holder = value_at(value, path[:-1])
    known: list[str] = []
    for shape in _shapes_at(schema, path[:-1], value):
        known += shape.get("properties", ())
    if mistake["type"] in _UNKNOWN:
        return path, key, ", ".join(sorted(known)) + suggestion(key, known)
    if isinstance(holder, dict) and key not in holder:
        unknown = [one for one in holder if one not in known]
        return path, None, f"{key!r} is needed here{suggestion(key, unknown, 'mean it by')}"
    given = value_at(value, path)
    words = [_words(shape) for shape in _shapes_at(schema, path, value)]
    allowed = " or ".join(dict.fromkeys(words))
    if isinstance(given, str):
        allowed += suggestion(given, allowed.split(" or "))
    elif isinstance(given, int | float) and "a text" in words:
        allowed += " (quote it)"
    return path, given, allowed


def _path(mistake: ErrorDetails, value: Any) -> KeyPath:
    """Return the path of a mistake; pydantic's names for a union's alternatives are left out."""
    path: list[Any] = []
    key: Any = None
    for part in mistake["loc"]:
        keys: Sequence[Any] = ()
        if isinstance(value, dict):
            keys = list(value)  # by position where the mapping is read as a list
        elif isinstance(value, list | tuple):
            keys = range(len(value))
        key = keys[part] if isinstance(part, int) and part < len(keys) else part
        if key in keys:
            path.append(key)
            value = value[key]
    about = mistake.get("ctx", {})
    own = about.get("error")
    if isinstance(own, InvalidValueError):
        path += own.place if isinstance(own.place, tuple) else (own.place,)
    elif mistake["type"] == "missing" and isinstance(key, str):
        path.append(key)
    elif "discriminator" in about:
        path.append(about["discriminator"].strip("'"))
    return tuple(path)


def value_at(value: Any, path: KeyPath) -> Any:
    """Return what stands at a path in plain values; None where nothing does."""
    for part in path:
        try:
            value = value[part]
        except (LookupError, TypeError):
            return None
    return value


def _shapes_at(schema: Schema, path: KeyPath, value: Any) -> list[Schema]:
    """Return the JSON Schemas of what may stand at a path, a union's alternatives each by itself."""
    shapes = list(_alternatives(schema, schema, value))
    for part in path:
        value = value_at(value, (part,))
        inner: list[Schema] = []
        for shape in shapes:
            each = shape.get("items") or shape.get("additionalProperties")
            one = shape.get("properties", {}).get(part, each)
            inner += _alternatives(one or {}, schema, value)
        shapes = inner
    return shapes


def _alternatives(shape: Schema, schema: Schema, value: Any) -> Iterator[Schema]:
    options = shape.get("anyOf") or shape.get("oneOf", ())
    if "discriminator" in shape:
        tag = value_at(value, (shape["discriminator"]["propertyName"],))
        meant = shape["discriminator"]["mapping"].get(str(tag))
        options = [{"$ref": meant}] if meant else options
    if "$ref" in shape:
        options = [schema["$defs"][shape["$ref"].rpartition("/")[2]]]
    for option in options:
        yield from _alternatives(option, schema, value)
    if not options and shape:
        yield shape


def _words(shape: Schema) -> str:
    """Return what a JSON Schema allows, in words."""
    kind = str(shape.get("type"))
    if "const" in shape:
        return str(shape["const"])
    if "enum" in shape:
        return " or ".join(map(str, shape["enum"]))
    if kind == "array" and "maxItems" in shape:
        item = _words(shape["items"])
        each = "numbers, all finite" if item == _PLAIN_WORDS["number"] else f"values, each {item}"
        return f"{shape['maxItems']} {each}"
    word = _PLAIN_WORDS.get(kind, "another value")
    without = [shape[end] for end in ("exclusiveMinimum", "exclusiveMaximum") if end in shape]
    low = shape.get("minimum", shape.get("exclusiveMinimum"))
    high: Any = shape.get("maximum", shape.get("exclusiveMaximum", math.inf))
    if low is None:
        return word
    if low in without and kind == "number":
        word = "a number"
    return f"{word} {Bounds(low, high, without=tuple(without))}"


def lost_values(
    given: Mapping[str, Any], read: Mapping[str, Any], above: str = ""
) -> dict[str, Any]:
    """Return what a log holds by keys that the value which was read from it does not have."""
    found: dict[str, Any] = {}
    for key, value in given.items():
        if key not in read:
            found[above + key] = value
        elif isinstance(value, dict) and isinstance(read[key], dict):
            found |= lost_values(value, read[key], f"{above}{key}.")
    return found
