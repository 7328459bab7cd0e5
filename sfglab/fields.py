"""Fields of dataclasses: documentation after ``#:`` or above, bounds, and values as JSON and back."""

from __future__ import annotations

import ast
import copy
import dataclasses
import inspect
import math
import sys
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any, TypeVar

from sfglab.errors import InvalidValueError

T = TypeVar("T")
BOUNDS = "bounds"  #: The key of a field's bounds in its metadata.


@dataclass(frozen=True, slots=True)
class Bounds:
    """The range of a field's values, both ends included unless left out."""

    low: float  #: Lowest value.
    high: float = math.inf  #: Highest value.
    log: bool = False  #: Whether steps are ratios, so that a slider has a logarithmic scale.
    without: tuple[float, ...] = ()  #: Ends that are left out.

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high and value not in self.without

    def __str__(self) -> str:
        low, high = (
            str(end) if isinstance(end, int) else f"{end:g}" for end in (self.low, self.high)
        )
        text = f"above {low if self.low else 'zero'}" if self.low in self.without else f"from {low}"
        if self.high == math.inf:
            return text
        return f"{text}, below {high}" if self.high in self.without else f"{text} to {high}"

    @property
    def limits(self) -> dict[str, float]:
        """The same as pydantic's keywords."""
        low = "gt" if self.low in self.without else "ge"
        high = "lt" if self.high in self.without else "le"
        ends = {low: self.low, high: self.high}
        return {word: end for word, end in ends.items() if math.isfinite(end)}

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        """Let pydantic check a number that is annotated with its range."""
        return {**handler(source), **self.limits}


def bounds(
    low: float = 0, high: float = math.inf, *, log: bool = False, without: tuple[float, ...] = ()
) -> dict[str, Any]:
    """Return metadata, as in ``field(metadata=bounds(1, 9))``; arguments as of `Bounds`."""
    allowed = Bounds(low, high, log, without)
    return {BOUNDS: allowed, **allowed.limits}


def between(
    default: T,
    low: float = 0,
    high: float = math.inf,
    *,
    log: bool = False,
    without: tuple[float, ...] = (),
) -> T:
    """Bound a field of a dataclass, whose default this is; further arguments as of `Bounds`."""
    return dataclasses.field(default=default, metadata=bounds(low, high, log=log, without=without))


def bounds_of(row_class: type[Any]) -> dict[str, Bounds]:
    """Return the bounds of a dataclass's fields, or of their items, by name."""
    hints = typing.get_type_hints(row_class, include_extras=True)
    found: dict[str, Bounds] = {}
    for field in dataclasses.fields(row_class):
        items = typing.get_args(hints[field.name])
        of_items = [more for item in items for more in getattr(item, "__metadata__", ())]
        for allowed in (field.metadata.get(BOUNDS), *of_items):
            if isinstance(allowed, Bounds):
                found[field.name] = allowed
    return found


def check_bounds(value: Any, about: str = "") -> None:
    """Check the bounded numbers of a dataclass, or raise an `InvalidValueError`.

    The error names the field, with `about` before it.
    """
    for field in dataclasses.fields(value):
        allowed = field.metadata.get(BOUNDS)
        given = getattr(value, field.name)
        if allowed is not None and given not in allowed:
            raise InvalidValueError(about + field.name, given, str(allowed))


def field_docs(row_class: type[Any]) -> dict[str, str]:
    """Return the documentation of a dataclass's fields, inherited ones included; empty without source files."""
    docs: dict[str, str] = {}
    for base in reversed(row_class.__mro__):
        docs |= _module_docs(base.__module__).get(base.__name__, {})
    return docs


@cache
def _module_docs(module: str) -> dict[str, dict[str, str]]:
    """Return the texts of all fields of a module's classes, by the class's name."""
    try:
        text = inspect.getsource(sys.modules[module])
    except (KeyError, OSError, TypeError):
        return {}
    lines = text.splitlines()
    found: dict[str, dict[str, str]] = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef):
            fields = [one for one in node.body if isinstance(one, ast.AnnAssign)]
            texts = {ast.unparse(field.target): _text(field, lines) for field in fields}
            found[node.name] = {name: text for name, text in texts.items() if text}
    return found


def _text(field: ast.AnnAssign, lines: list[str]) -> str:
    """Return the text behind ``#:`` on a field's last line, else on the lines directly above it."""
    last = lines[(field.end_lineno or field.lineno) - 1]
    _, marker, text = last.encode()[field.end_col_offset :].decode().partition("#:")
    if marker:
        return text.strip()
    above: list[str] = []
    for line in reversed(lines[: field.lineno - 1]):
        if not line.lstrip().startswith("#:"):
            break
        above.insert(0, line.strip().removeprefix("#:").strip())
    return " ".join(above)


@cache
def typed_fields(cls: type[Any]) -> dict[str, dataclasses.Field[Any]]:
    """Return the fields of a dataclass by name, with their types, which must be importable at run time."""
    hints = typing.get_type_hints(cls)
    fields = {f.name: copy.copy(f) for f in dataclasses.fields(cls)}
    for name, field in fields.items():
        field.type = hints[name]
    return fields


def choices_of(hint: Any) -> dict[str, Any]:
    """Return the values that an enumeration or a ``Literal`` allows by their texts; none of other types."""
    if typing.get_origin(hint) is typing.Literal:
        return {choice: choice for choice in typing.get_args(hint)}
    is_enum = isinstance(hint, type) and issubclass(hint, Enum)
    return {str(member.value): member for member in hint} if is_enum else {}


def to_json(value: Any) -> Any:
    """Return a value as JSON has it: dataclasses as objects, enums by their value, tuples as lists."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_json(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(to_json(k)): to_json(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [to_json(v) for v in value]
    return value


def from_json(hint: Any, value: Any) -> Any:  # noqa: PLR0911  # one return a kind of type
    """Return a JSON value as an annotated type: what `to_json` of such a value gave, or a value of it already.

    Keys that a dataclass does not have are left out, fields that are missing take their defaults: what another
    version wrote stays readable. Fields' types must be importable at run time.

    Raises:
        InvalidValueError: The value has no form in that type.
    """
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type) and isinstance(value, Mapping):
        return _dataclass_from_json(hint, value)
    if origin in (typing.Union, types.UnionType):
        return _union_from_json(arguments, value)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _made(hint, value)
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    if origin is tuple and is_list:
        each = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        return tuple(from_json(h, v) for h, v in zip(each, value, strict=True))
    if origin in (list, Sequence, frozenset, set) and is_list:
        made = (from_json(arguments[0], v) for v in value)
        return tuple(made) if origin is Sequence else origin(made)
    if origin in (dict, Mapping) and isinstance(value, Mapping):
        return {from_json(arguments[0], k): from_json(arguments[1], v) for k, v in value.items()}
    return _made(hint, value) if hint in (float, int) and not isinstance(value, bool) else value


def _dataclass_from_json(hint: type[Any], value: Mapping[str, Any]) -> Any:
    fields = [
        f for f in typed_fields(typing.cast("Any", hint)).values() if f.init and f.name in value
    ]
    try:
        return hint(**{f.name: from_json(f.type, value[f.name]) for f in fields})
    except (TypeError, KeyError) as error:
        raise InvalidValueError(hint.__name__, dict(value), str(error)) from error


def _union_from_json(options: tuple[Any, ...], value: Any) -> Any:
    if value is None and type(None) in options:
        return None
    for option in options:
        if isinstance(option, type) and isinstance(value, option):
            return value
    refused: Exception | None = None
    for option in options:
        try:
            return from_json(option, value)
        except (TypeError, ValueError) as error:
            refused = error
    raise InvalidValueError("value", value, " or ".join(map(str, options))) from refused


def _made(hint: Any, value: Any) -> Any:
    try:
        return hint(value)
    except (TypeError, ValueError) as error:
        raise InvalidValueError("value", value, hint.__name__) from error
