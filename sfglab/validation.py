"""Conversion of given values to types with pydantic; each mistake becomes an error of sfglab.

Types and bounds are declared in dataclasses (`sfglab.fields`). Pydantic is imported at the first conversion, because
the import takes 0.1 s. The `Source` decides how strict the conversion is. Values of people must have known keys, and
numbers, truth values and texts are not converted into each other: "3" is no number. Logs may be of another version.
"""

from __future__ import annotations

import math
import re
from difflib import get_close_matches
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, KeyPath, key_text
from sfglab.fields import Bounds

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from pydantic_core import ErrorDetails, SchemaValidator


class Source(Enum):
    """Origin of values, which decides how strictly they are checked."""

    #: File of a person: empty texts are refused, and null does not stand for a missing value.
    FILE = "file"
    VALUES = "values"  #: Program, command or form of a person.
    #: Log of any version of sfglab: unknown keys are ignored, and bounds are not checked.
    LOG = "log"


Core = dict[str, Any]  #: Pydantic's description of a type.
_STRICT: dict[str, Core] = {kind: {"strict": True} for kind in ("int", "float", "bool", "str")}
_RULES: dict[Source, dict[str, Core]] = {
    Source.FILE: {
        **_STRICT,
        "float": {"strict": True, "allow_inf_nan": False},
        "str": {"strict": True, "min_length": 1},
    },
    Source.VALUES: _STRICT,
    Source.LOG: {},
}
"""Additions to core schemas, by their ``type``."""
_LIMITS = ("ge", "gt", "le", "lt")
_MAPPING = "a mapping of keys to values"
_LIST = "a list, such as [1, 7]"
_WORDS = {
    "int_type": "a whole number",
    "float_type": "a number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "string_type": "a text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "none_required": "nothing",
    "list_type": _LIST,
    "tuple_type": _LIST,
    "set_type": _LIST,
    "frozen_set_type": _LIST,
    "dict_type": _MAPPING,
    "dataclass_type": _MAPPING,
    "model_attributes_type": _MAPPING,
    # The type is a `sfglab.documents.Place`, which files do not have.
    "is_instance_of": "no such key",
}
"""Allowed values by the type of pydantic's error, where pydantic's own words name types of Python."""


def suggestion(word: object, known: Iterable[str], meant: str = "mean") -> str:
    """Return the text ``; did you mean 'x'?`` for the closest known word; empty if no word is close."""
    close = get_close_matches(str(word), list(known), n=1, cutoff=0.6)
    return f"; did you {meant} {close[0]!r}?" if close else ""


def read(hint: Any, value: Any, about: str = "", source: Source = Source.VALUES) -> Any:
    """Return a value converted to a type.

    Args:
        hint: The type.
        value: The value, in plain types or already of the type.
        about: Text before the key in an error; without it the error's place is the path of keys.
        source: Origin of the value.

    Raises:
        InvalidValueError: The value does not fit the type. Of several mistakes the error has the first of the most
            deeply nested ones: if alternatives of a type are refused, the intended one is refused more deeply inside.
    """
    from pydantic import ValidationError

    try:
        return _validator(hint, source).validate_python(value)
    except ValidationError as error:
        path, given, allowed = _mistake(error.errors(include_url=False), value)
        if source is Source.FILE and isinstance(given, int | float) and "a text" in allowed:
            allowed += " (quote it)"
        place = about + key_text(path) if about else path
        raise InvalidValueError(place, given, allowed) from error


@cache
def _validator(hint: Any, source: Source) -> SchemaValidator:
    from pydantic_core import SchemaValidator

    return SchemaValidator(core_of(hint, source))


@cache
def core_of(hint: Any, source: Source) -> Core:
    """Return pydantic's core schema of a type for values of a source."""
    from pydantic import TypeAdapter

    core: Core = _ruled(TypeAdapter(hint).core_schema, source)
    return core


def _ruled(core: Any, source: Source) -> Any:
    """Return a core schema, or a part of one, with the rules of a source."""
    if isinstance(core, list):
        return [_ruled(one, source) for one in core]
    if not isinstance(core, dict):
        return core
    kind = core.get("type")
    if kind == "nullable" and source is Source.FILE:
        return _ruled(core["schema"], source)
    left_out = _LIMITS if source is Source.LOG else ()
    made = {key: _ruled(value, source) for key, value in core.items() if key not in left_out}
    made |= _RULES[source].get(str(kind), {})
    if kind == "dataclass-args" and source is not Source.LOG:
        made = _with_known_keys(made)
    elif kind in {"int", "float"} and not made.keys().isdisjoint(_LIMITS):
        made = _with_range(made)
    elif kind == "tuple" and "variadic_item_index" not in made:
        made = _with_length(made)
    return made


def _with_range(core: Core) -> Core:
    """Return the core schema of a number with errors that name its whole range."""
    from pydantic_core.core_schema import custom_error_schema

    word = "a whole number" if core["type"] == "int" else "a number"
    if core.get("allow_inf_nan") is False:
        word = "a finite number"
    without = [core[end] for end in ("gt", "lt") if end in core]
    low: Any = core.get("ge", core.get("gt", -math.inf))
    high: Any = core.get("le", core.get("lt", math.inf))
    allowed = Bounds(low, high, without=tuple(without))
    said = f"Input should be {word} {allowed}"
    return {**custom_error_schema(core, custom_error_type="range", custom_error_message=said)}


def _with_length(core: Core) -> Core:
    """Return the core schema of a tuple that first checks its length."""
    from pydantic_core.core_schema import no_info_before_validator_function

    length = len(core["items_schema"])

    def check(given: Any) -> Any:
        if isinstance(given, list | tuple) and len(given) != length:
            raise InvalidValueError((), given, f"{length} values")
        return given

    return {**no_info_before_validator_function(check, core)}


def _with_known_keys(core: Core) -> Core:
    """Return the core schema of a dataclass's fields that first checks the keys."""
    from pydantic_core.core_schema import no_info_before_validator_function

    known = set()
    needed = []
    for field in core["fields"]:
        key = field.get("validation_alias", field["name"])
        inner = field["schema"]
        if inner["type"] != "default":
            needed.append(key)
        elif inner["schema"]["type"] == "is-instance":
            continue  # a place
        known.add(key)

    def check(given: Any) -> Any:
        if isinstance(given, dict):
            unknown = [key for key in given if key not in known]
            for key in needed:
                if key not in given:
                    raise InvalidValueError((key,), None, _needed(key, unknown))
            for key in unknown:
                allowed = f"the keys {', '.join(sorted(known))}{suggestion(key, known)}"
                raise InvalidValueError((key,), key, allowed)
        return given

    return {**no_info_before_validator_function(check, core)}


def _needed(key: str, unknown: Iterable[str]) -> str:
    return f"the key {key!r}{suggestion(key, unknown, 'misspell it as')}"


def _mistake(mistakes: list[ErrorDetails], value: Any) -> tuple[KeyPath, object, str]:
    """Return path, given value and allowed values of the first of the most deeply nested mistakes."""
    paths = [_path(mistake, value) for mistake in mistakes]
    path = max(paths, key=len)
    found = [mistake for mistake, place in zip(mistakes, paths, strict=True) if place == path]
    own = found[0].get("ctx", {}).get("error")
    if isinstance(own, InvalidValueError):
        return path, own.given, own.allowed
    if found[0]["type"] == "union_tag_not_found":
        *outer, tag = path
        return path, None, _needed(str(tag), value_at(value, tuple(outer)))
    given = value_at(value, path)
    quoted = " or ".join(dict.fromkeys(map(_words, found)))
    allowed = quoted.replace("'", "")
    if isinstance(given, str):
        allowed += suggestion(given, re.findall("'(.*?)'", quoted))
    return path, given, allowed


def _words(mistake: ErrorDetails) -> str:
    """Return the allowed values for a mistake, in words."""
    tags: str | None = mistake.get("ctx", {}).get("expected_tags")
    own = mistake["msg"].partition(" should ")[2].removeprefix("be ").removeprefix("have ")
    return _WORDS.get(mistake["type"]) or tags or own or mistake["msg"]


def _path(mistake: ErrorDetails, value: Any) -> KeyPath:
    """Return the path of a mistake; pydantic's names for a union's alternatives are left out."""
    path: list[Any] = []
    for part in mistake["loc"]:
        keys: Collection[Any] = ()
        if isinstance(value, dict):
            keys = value
        elif isinstance(value, list | tuple):
            keys = range(len(value))
        if part in keys:
            path.append(part)
            value = value[part]
    about = mistake.get("ctx", {})
    own = about.get("error")
    if isinstance(own, InvalidValueError):
        path += own.place if isinstance(own.place, tuple) else (own.place,)
    elif "discriminator" in about:
        path.append(about["discriminator"].strip("'"))
    return tuple(path)


def value_at(value: Any, path: KeyPath) -> Any:
    """Return the value at a path in plain values; None if there is none."""
    for part in path:
        try:
            value = value[part]
        except (LookupError, TypeError):
            return None
    return value


def lost_values(given: Any, read: Any, above: str = "") -> dict[str, Any]:
    """Return the values of a log that are missing in the object that was read from them, by key.

    The name of a key contains the keys and list positions above it, such as ``fleets.0.kinds``.

    Args:
        given: Plain values of the log.
        read: Object that was read from them.
        above: Keys above the values.
    """
    if isinstance(given, list) and isinstance(read, list):
        given, read = dict(enumerate(given)), dict(enumerate(read))
    if not isinstance(given, dict) or not isinstance(read, dict):
        return {}
    found: dict[str, Any] = {}
    for key, value in given.items():
        if key in read:
            found |= lost_values(value, read[key], f"{above}{key}.")
        else:
            found[f"{above}{key}"] = value
    return found
