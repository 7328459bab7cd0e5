"""Values that people give, read as typed fields by pydantic, and each mistake as one of our errors.

Dataclasses say types and bounds (`sfglab.fields`); pydantic is imported when something is read, since
it takes 0.1 s. Numbers, truth values and texts must be of their own kind: "3" is no number. `read`
refuses unknown keys; `read_logged` reads what another version wrote.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, KeyPath, key_text
from sfglab.fields import Bounds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from pydantic import ValidationError
    from pydantic_core import ErrorDetails, SchemaValidator

Shape = dict[str, Any]  #: The JSON Schema of a value.
Refusal = tuple[KeyPath, object, str]  #: Path of the keys, given value, and allowed values.

_SCALARS = ("int", "float", "bool", "str")
_LIMITS = ("ge", "gt", "le", "lt")


def suggestion(word: object, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the closest known word, or nothing when none is close."""
    close = get_close_matches(str(word), list(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else ""


@dataclass(frozen=True, slots=True)
class Reader:
    """Reads values of one type."""

    validator: SchemaValidator
    core: Any  #: Pydantic's own description of the type.

    def read(self, value: Any, refuse: Callable[[KeyPath, object, str], Exception]) -> Any:
        """Return a value as the type, or raise what `refuse` makes of its first mistake."""
        from pydantic import ValidationError

        try:
            return self.validator.validate_python(value)
        except ValidationError as error:
            raise refuse(*self._first_mistake(error, value)) from error

    def _first_mistake(self, error: ValidationError, value: Any) -> Refusal:
        """Return the first mistake; of a union's alternatives, that of the one which fits best."""
        details = error.errors(include_url=False)
        mistake = max(details, key=lambda one: len(_path(one, value)))
        return self._refusal(mistake, value)

    def _refusal(self, mistake: ErrorDetails, value: Any) -> Refusal:
        path = _path(mistake, value)
        own = mistake.get("ctx", {}).get("error")
        if isinstance(own, InvalidValueError):
            place = path + (own.place if isinstance(own.place, tuple) else (own.place,))
            known = isinstance(own.place, tuple) or self._shapes(place, value)
            return (place if known else path), own.given, own.allowed
        is_missing = mistake["type"] in ("missing", "union_tag_not_found")
        if mistake["type"].startswith("union_tag"):
            path += (mistake["ctx"]["discriminator"].strip("'"),)
        holder, key = path[:-1], path[-1] if path else ""
        keys = [k for shape in self._shapes(holder, value) for k in shape.get("properties", ())]
        if is_missing and isinstance(key, str) and key not in value_at(value, holder):
            unknown = [other for other in value_at(value, holder) if other not in keys]
            close = get_close_matches(str(key), unknown, n=1, cutoff=0.6)
            slip = f"; did you mean it by {close[0]!r}?" if close else ""
            return path, None, f"{key!r} is needed here{slip}"
        shapes = self._shapes(path, value)
        if not shapes:
            return path, key, ", ".join(sorted(keys)) + suggestion(key, keys)
        found = value_at(value, path)
        return path, found, described(shapes, found)

    def _shapes(self, path: KeyPath, value: Any) -> list[Shape]:
        """Return what may stand at a path, each alternative of a union for itself."""
        schema = self.shape()
        shapes = list(_alternatives(schema, schema))
        for part in path:
            of_kind = [shape for shape in shapes if _is_kind(shape, value, part)]
            inner = [inside for shape in of_kind for inside in _inside(shape, part)]
            shapes = [one for shape in inner for one in _alternatives(shape, schema)]
            value = value_at(value, (part,))
        return shapes

    def shape(self) -> Shape:
        """Return the JSON Schema of the type."""
        from pydantic.json_schema import GenerateJsonSchema

        return GenerateJsonSchema().generate(self.core)


def _alternatives(shape: Shape, schema: Shape) -> Iterator[Shape]:
    while "$ref" in shape:
        shape = schema["$defs"][shape["$ref"].rpartition("/")[2]]
    options = shape.get("anyOf") or shape.get("oneOf")
    if options is None:
        yield shape
        return
    for option in options:
        yield from _alternatives(option, schema)


def _is_kind(shape: Shape, value: Any, but: str | int) -> bool:
    """Return whether a mapping is of the kind that a schema says, by each key with a fixed value."""
    fixed = {k: s["const"] for k, s in shape.get("properties", {}).items() if "const" in s}
    return all(key == but or value_at(value, (key,)) == fixed[key] for key in fixed)


def _inside(shape: Shape, part: str | int) -> Iterator[Shape]:
    """Yield the schema of a mapping's member or of a list's item."""
    if isinstance(part, int):
        items = shape.get("prefixItems", ())
        inner = items[part] if part < len(items) else shape.get("items")
    else:
        inner = shape.get("properties", {}).get(part) or shape.get("additionalProperties")
    if isinstance(inner, dict):
        yield inner


def described(shapes: Iterable[Shape], given: object) -> str:
    """Return in words what may stand somewhere, and which of the words was meant."""
    words = dict.fromkeys(_words(shape) for shape in shapes)
    choices = [choice for shape in shapes for choice in _choices(shape)]
    if isinstance(given, str):
        return " or ".join(words) + suggestion(given, choices)
    is_plain = not isinstance(given, dict | list) and given is not None
    return " or ".join(words) + (" (quote it)" if is_plain and "a text" in words else "")


def _choices(shape: Shape) -> list[str]:
    return [
        str(choice) for choice in shape.get("enum", [shape["const"]] if "const" in shape else [])
    ]


def _words(shape: Shape) -> str:
    if choices := _choices(shape):
        return " or ".join(choices)
    kind = shape.get("type")
    if kind in ("integer", "number"):
        return _number_words(shape)
    if kind == "array":
        return _list_words(shape)
    if kind == "string" and "examples" in shape:
        return f"a text as {' or '.join(shape['examples'])}"
    return _KINDS.get(str(kind), "another value")


_KINDS = {
    "object": "a mapping of keys to values",
    "boolean": "true or false",
    "string": "a text",
    "null": "nothing",
}


def _number_words(shape: Shape) -> str:
    word = "a whole number" if shape["type"] == "integer" else "a finite number"
    low, high = shape.get("minimum"), shape.get("maximum")
    above, below = shape.get("exclusiveMinimum"), shape.get("exclusiveMaximum")
    without = tuple(end for end in (above, below) if end is not None)
    lowest = low if above is None else above
    highest = high if below is None else below
    if lowest is None:
        return word
    if above is not None and shape["type"] == "number":
        word = "a number"
    bounds = Bounds(lowest, math.inf if highest is None else highest, without=without)
    return f"{word} {bounds}"


def _list_words(shape: Shape) -> str:
    if "prefixItems" in shape:
        return f"{shape['minItems']} numbers, all finite"
    texts = shape.get("items", {}).get("type") == "string"
    return "a list of texts (quote numbers)" if texts else "a list"


def value_at(value: Any, path: KeyPath) -> Any:
    """Return what stands at a path in plain values; None where nothing does."""
    for part in path:
        try:
            value = value[part]
        except (LookupError, TypeError):
            return None
    return value


def _path(mistake: ErrorDetails, value: Any) -> KeyPath:
    """Return where a mistake is; pydantic's names for a union's alternatives are left out."""
    path: list[str | int] = []
    for position, part in enumerate(mistake["loc"]):
        if isinstance(value, dict):
            key = list(value)[part] if isinstance(part, int) else part
            needed = mistake["type"] == "missing" and position == len(mistake["loc"]) - 1
            if key not in value and not needed:
                continue  # a name of pydantic's for a union's alternative
            path.append(key)
            value = value.get(key)
        elif isinstance(value, list | tuple) and isinstance(part, int) and part < len(value):
            path.append(part)
            value = value[part]
    return tuple(path)


# How strictly a value is read: each changes pydantic's description of one type, as a mapping.


def _exact(core: dict[str, Any]) -> dict[str, Any]:
    """Let a number, a truth value and a text be of their own kind."""
    return {**core, "strict": True} if core["type"] in _SCALARS else core


_NEVER_WRITTEN: dict[str, dict[str, Any]] = {
    "str": {"min_length": 1},
    "float": {"allow_inf_nan": False},
}


def _written(core: dict[str, Any]) -> dict[str, Any]:
    """Refuse empty texts, infinite numbers, and null for what is left out."""
    if core["type"] == "nullable":
        inner: dict[str, Any] = core["schema"]
        return inner
    return {**_exact(core), **_NEVER_WRITTEN.get(core["type"], {})}


def _unbounded(core: dict[str, Any]) -> dict[str, Any]:
    """Leave out the bounds of a number, which another version may have had otherwise."""
    return {key: value for key, value in core.items() if key not in _LIMITS}


@cache
def _reader(hint: Any, change: Callable[[dict[str, Any]], dict[str, Any]], extra: str) -> Reader:
    from pydantic import ConfigDict, TypeAdapter
    from pydantic_core import SchemaValidator

    config = ConfigDict(extra=extra, regex_engine="python-re")  # type: ignore[typeddict-item]
    # A configuration cannot be given beside a dataclass, only beside what holds it.
    adapter = TypeAdapter(dict[str, hint], config=config)
    core = _changed(adapter.core_schema, change)
    definitions = core.get("definitions", [])
    inner = core["schema"] if definitions else core
    core = inner["values_schema"]
    if definitions:
        core = {"type": "definitions", "schema": core, "definitions": definitions}
    return Reader(SchemaValidator(core), core)


def _changed(core: Any, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Any:
    """Return pydantic's description of a type with the description of each inner one changed."""
    if isinstance(core, list):
        return [_changed(one, change) for one in core]
    if not isinstance(core, dict):
        return core
    made = {key: _changed(value, change) for key, value in core.items()}
    return change(made) if isinstance(made.get("type"), str) else made


def strict_reader(hint: Any) -> Reader:
    """Return the reader of values that code gives: unknown keys are refused."""
    return _reader(hint, _exact, "forbid")


def file_reader(hint: Any) -> Reader:
    """Return the reader of values in files that people write: as strict, and texts are not empty."""
    return _reader(hint, _written, "forbid")


def read(hint: Any, value: Any, about: str = "") -> Any:
    """Return a value as a type, or raise an `InvalidValueError` that names the key below `about`."""

    def refusal(path: KeyPath, given: object, allowed: str) -> InvalidValueError:
        return InvalidValueError(f"{about}{key_text(path)}", given, allowed)

    return strict_reader(hint).read(value, refusal)


def read_logged(hint: Any, value: Any) -> Any:
    """Return what some version wrote into a log as a type; unknown keys and bounds do not count."""

    def refusal(path: KeyPath, given: object, allowed: str) -> InvalidValueError:
        return InvalidValueError(key_text(path), given, allowed)

    return _reader(hint, _unbounded, "ignore").read(value, refusal)


def unknown_keys(given: Mapping[str, Any], read: Mapping[str, Any], above: str = "") -> list[str]:
    """Return the keys of what a log holds that the value which was read from it does not have."""
    found: list[str] = []
    for key, value in given.items():
        if key not in read:
            found.append(above + key)
        elif isinstance(value, dict) and isinstance(read[key], dict):
            found += unknown_keys(value, read[key], f"{above}{key}.")
    return found


def read_entry(hint: Any, entry: Any) -> Any:
    """Return what stands in a form as a type, numbers also as text."""

    def refusal(_: KeyPath, given: object, allowed: str) -> InvalidValueError:
        return InvalidValueError("value", given, allowed)

    return _reader(hint, dict, "forbid").read(entry, refusal)
