"""Fields of dataclasses: bounds, documentation after ``#:`` or above, and values as JSON and back.

This module does not import pydantic. A child process reads its configuration with `from_json`.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import inspect
import math
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from sfglab.errors import InvalidValueError

T = TypeVar("T")
BOUNDS = "bounds"  #: The key of a field's bounds in its metadata.
_CONTAINERS: dict[Any, Callable[[list[Any]], Any]] = {
    list: list,
    tuple: tuple,
    Sequence: tuple,
    set: set,
    frozenset: frozenset,
}


@dataclass(frozen=True, slots=True)
class Bounds:
    """Range of a number, both ends included unless `without` excludes them."""

    low: float  #: Lowest value.
    high: float = math.inf  #: Highest value.
    log: bool = False  #: Whether a slider has a logarithmic scale.
    without: tuple[float, ...] = ()  #: Excluded ends.

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high and value not in self.without

    def __str__(self) -> str:
        text = f"from {self.low:.12g}"
        if self.low in self.without:
            text = f"above {self.low:.12g}" if self.low else "above zero"
        if self.high == math.inf:
            return text
        word = ", below" if self.high in self.without else " to"
        return f"{text}{word} {self.high:.12g}"

    @property
    def limits(self) -> dict[str, float]:
        """Finite ends of the range, by pydantic's keywords."""
        low = "gt" if self.low in self.without else "ge"
        high = "lt" if self.high in self.without else "le"
        ends = {low: self.low, high: self.high}
        return {word: end for word, end in ends.items() if math.isfinite(end)}

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Let pydantic check a number that is annotated with its range."""
        return {**handler(source), **self.limits}


def bounds(
    low: float = 0, high: float = math.inf, *, without: tuple[float, ...] = ()
) -> dict[str, Any]:
    """Return metadata that bounds a field of a dataclass, as in ``field(metadata=bounds(1, 9))``.

    The arguments are those of `Bounds`.
    """
    allowed = Bounds(low, high, without=without)
    return {BOUNDS: allowed, **allowed.limits}


def between(
    default: T, low: float = 0, high: float = math.inf, *, without: tuple[float, ...] = ()
) -> T:
    """Return a field of a dataclass with a default and a range; the further arguments are those of `Bounds`."""
    return dataclasses.field(default=default, metadata=bounds(low, high, without=without))


def bounds_of(row_class: type[Any]) -> dict[str, Bounds]:
    """Return the bounds of a dataclass's fields, or of the items of a field, by the field's name."""
    hints = get_type_hints(row_class, include_extras=True)
    found: dict[str, Bounds] = {}
    for field in dataclasses.fields(row_class):
        hint = hints[field.name]
        marks = [field.metadata.get(BOUNDS)]
        for item in (hint, *get_args(hint)):
            marks += getattr(item, "__metadata__", ())
        for mark in marks:
            if isinstance(mark, Bounds):
                found[field.name] = mark
    return found


def check_bounds(value: Any, about: str = "") -> None:
    """Check that the numbers of a dataclass are in their ranges; None is allowed.

    Args:
        value: Object of the dataclass.
        about: Text before the name of the field in errors.

    Raises:
        InvalidValueError: A number is out of its range.
    """
    for field in dataclasses.fields(value):
        allowed = field.metadata.get(BOUNDS)
        given = getattr(value, field.name)
        if allowed is not None and given is not None and given not in allowed:
            raise InvalidValueError(about + field.name, given, str(allowed))


def field_docs(row_class: type[Any]) -> dict[str, str]:
    """Return the documentation of a dataclass's fields, inherited ones included.

    The documentation is read from the source files at the first call for a module; without source files it is empty.
    """
    docs: dict[str, str] = {}
    for base in reversed(row_class.__mro__):
        docs |= _module_docs(base.__module__).get(base.__name__, {})
    return docs


@cache
def _module_docs(module: str) -> dict[str, dict[str, str]]:
    """Return the documentation of all fields of a module's classes, by the class's name."""
    try:
        text = inspect.getsource(sys.modules[module])
    except (KeyError, OSError, TypeError):
        return {}
    lines = text.splitlines()
    found: dict[str, dict[str, str]] = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef):
            found[node.name] = _class_docs(node, lines)
    return found


def _class_docs(node: ast.ClassDef, lines: list[str]) -> dict[str, str]:
    """Return the text after ``#:`` for each field, between the statement before the field and its end."""
    docs: dict[str, str] = {}
    begin = node.lineno
    for field in node.body:
        end = field.end_lineno or field.lineno
        parts = [line.partition("#:")[2].strip() for line in lines[begin:end]]
        text = " ".join(filter(None, parts))
        if isinstance(field, ast.AnnAssign) and text:
            docs[ast.unparse(field.target)] = text
        begin = end
    return docs


@cache
def types_of(cls: type[Any]) -> dict[str, Any]:
    """Return the types of a dataclass's fields by the field's name; the types must be importable at run time."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls) if field.init}


def choices_of(hint: Any) -> dict[str, Any]:
    """Return the values of an enumeration or a ``Literal`` by their texts; empty for other types."""
    if get_origin(hint) is Literal:
        return {choice: choice for choice in get_args(hint)}
    return {str(member.value): member for member in hint} if _is_enum(hint) else {}


def _is_enum(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, Enum)


def to_json(value: Any) -> Any:
    """Return a value as JSON: dataclasses become objects, enums their values, tuples lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_json(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(to_json(k)): to_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_json(v) for v in value]
    return value


def from_json(hint: Any, value: Any) -> Any:
    """Return the value of a type that `to_json` converted to JSON; a value of the type is returned unchanged.

    Unknown keys of a dataclass are left out, and missing fields have their defaults, so that configurations of
    other versions stay readable. The types of fields must be importable at run time.

    Raises:
        InvalidValueError: The value does not fit the type.
    """
    origin = get_origin(hint)
    arguments = get_args(hint)
    if origin in (Union, types.UnionType):
        return _first_of(arguments, value)
    if isinstance(value, Mapping):
        if dataclasses.is_dataclass(hint):
            known = types_of(cast("Any", hint))
            given = {name: from_json(known[name], value[name]) for name in known if name in value}
            return _called(hint, given)
        if origin in (dict, Mapping):
            key, each = arguments
            return {from_json(key, k): from_json(each, v) for k, v in value.items()}
    if origin in _CONTAINERS and isinstance(value, list | tuple):
        hints = arguments
        if origin is not tuple or arguments[-1] is ...:
            hints = arguments[:1] * len(value)
        items = [from_json(h, v) for h, v in zip(hints, value, strict=True)]
        return _CONTAINERS[origin](items)
    if hint in (int, float) or _is_enum(hint):
        return _called(hint, value)
    return value


def _first_of(options: tuple[Any, ...], value: Any) -> Any:
    """Return a value unchanged if it is an instance of an option, or as the first option that accepts it."""
    if any(isinstance(option, type) and isinstance(value, option) for option in options):
        return value
    for option in options:
        with contextlib.suppress(TypeError, ValueError):
            return from_json(option, value)
    raise InvalidValueError("value", value, " or ".join(map(str, options)))


def _called(hint: Any, given: Any) -> Any:
    try:
        return hint(**given) if isinstance(given, dict) else hint(given)
    except InvalidValueError:
        raise
    except (TypeError, ValueError) as error:
        raise InvalidValueError("value", given, f"{hint.__name__} ({error})") from error
