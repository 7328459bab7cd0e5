"""Values that people give, read as typed fields by pydantic, and each mistake as one of our errors.

Dataclasses say types and bounds (`sfglab.fields`). Pydantic is imported when something is read, since
it takes 0.1 s. It describes a type by nested mappings: here each mapping gets our rules and words
before pydantic makes a validator of it. Numbers, truth values and texts must be of their own kind:
"3" is no number. `read` refuses unknown keys; `read_logged` reads what another version wrote.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, KeyPath, key_text
from sfglab.fields import Bounds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pydantic_core import ErrorDetails, SchemaValidator

Core = dict[str, Any]  #: Pydantic's description of a type.
_LIMITS = ("ge", "gt", "le", "lt")


def suggestion(word: object, known: Iterable[str], meant: str = "mean") -> str:
    """Return ``; did you mean 'x'?`` for the closest known word, or nothing when none is close."""
    close = get_close_matches(str(word), list(known), n=1, cutoff=0.6)
    return f"; did you {meant} {close[0]!r}?" if close else ""


@dataclass(frozen=True, slots=True)
class Reader:
    """Reads values of one type."""

    validator: SchemaValidator
    core: Core  #: The type without our words, of which a JSON Schema can be made.

    def read(self, value: Any, refuse: Callable[[KeyPath, object, str], Exception]) -> Any:
        """Return a value as the type, or raise what `refuse` makes of its first mistake."""
        from pydantic import ValidationError

        try:
            return self.validator.validate_python(value)
        except ValidationError as error:
            mistakes = error.errors(include_url=False)
            raise refuse(*_worst(mistakes, value)) from error


def _worst(mistakes: list[ErrorDetails], value: Any) -> tuple[KeyPath, object, str]:
    """Return the path, the value and what is allowed of the first of the deepest mistakes.

    Alternatives of a union are refused at one path: all of them are allowed there.
    """
    found: dict[KeyPath, list[tuple[object, str, bool]]] = {}  # the last: our own words
    for mistake in mistakes:
        path = _path(mistake["loc"], value)
        own = mistake.get("ctx", {}).get("error")
        if isinstance(own, InvalidValueError):
            path += own.place if isinstance(own.place, tuple) else (own.place,)
            refused = own.given, own.allowed, True
        else:
            words = _CONTAINERS.get(mistake["type"], mistake["msg"])
            refused = value_at(value, path), words, False
        found.setdefault(path, []).append(refused)
    deepest = max(found, key=len)
    given, _, is_own = found[deepest][0]
    allowed = " or ".join(dict.fromkeys(words for _, words, _ in found[deepest]))
    if is_own:
        return deepest, given, allowed
    if isinstance(given, str):
        allowed += suggestion(given, allowed.split(" or "))
    elif isinstance(given, int | float) and "a text" in allowed:
        allowed += " (quote it)"
    return deepest, given, allowed


_CONTAINERS = {
    **dict.fromkeys(("tuple_type", "list_type", "frozen_set_type"), "a list"),
    **dict.fromkeys(("dict_type", "mapping_type"), "a mapping of keys to values"),
}


def _path(loc: tuple[int | str, ...], value: Any) -> KeyPath:
    """Return the path of a mistake; pydantic's names for a union's alternatives are left out."""
    path: list[str | int] = []
    for part in loc:
        if isinstance(value, dict):
            key = list(value)[part] if isinstance(part, int) else part
            if key in value:
                path.append(key)
                value = value[key]
        elif isinstance(value, list | tuple) and isinstance(part, int):
            path.append(part)
            value = value[part]
    return tuple(path)


def value_at(value: Any, path: KeyPath) -> Any:
    """Return what stands at a path in plain values; None where nothing does."""
    for part in path:
        try:
            value = value[part]
        except (LookupError, TypeError):
            return None
    return value


# How strictly a type is read: each function changes one mapping of its description.


def _exact(core: Core) -> Core:
    """Let a number, a truth value and a text be of their own kind."""
    return {**core, "strict": True} if core["type"] in ("int", "float", "bool", "str") else core


_NEVER_WRITTEN: dict[str, Core] = {"str": {"min_length": 1}, "float": {"allow_inf_nan": False}}


def _written(core: Core) -> Core:
    """Refuse empty texts, infinite numbers, and null for what is left out."""
    if core["type"] == "nullable":
        inner: Core = core["schema"]
        return inner
    return {**_exact(core), **_NEVER_WRITTEN.get(core["type"], {})}


def _unbounded(core: Core) -> Core:
    """Leave out the bounds of a number, which another version may have had otherwise."""
    return {key: value for key, value in core.items() if key not in _LIMITS}


# Words for the allowed values.


def _worded(core: Core) -> Core:
    """Let a mistake say what is allowed, and check the keys of a mapping."""
    words = _words(core)
    if words:
        allowed = {"custom_error_type": "allowed", "custom_error_message": words}
        return _around(core, {"type": "custom-error", **allowed})
    check = _check_of(core)
    if check is None:
        return core
    return _around(
        core, {"type": "function-before", "function": {"type": "no-info", "function": check}}
    )


def _around(core: Core, outer: Core) -> Core:
    """Return a description around another one, whose name for references it takes over."""
    ref = {"ref": core["ref"]} if "ref" in core else {}
    return {**outer, **ref, "schema": {key: value for key, value in core.items() if key != "ref"}}


def _words(core: Core) -> str:
    """Return what a scalar may be; empty for anything else."""
    kind = core["type"]
    if kind in ("int", "float"):
        return _number_words(core)
    if kind == "enum":
        return " or ".join(str(member.value) for member in core["members"])
    if kind == "literal":
        return " or ".join(map(str, core["expected"]))
    return {"bool": "true or false", "str": "a text", "none": "nothing"}.get(kind, "")


def _number_words(core: Core) -> str:
    low, high = core.get("gt", core.get("ge")), core.get("lt", core.get("le"))
    word = "a whole number" if core["type"] == "int" else "a finite number"
    if low is None:
        return word
    if "gt" in core and core["type"] == "float":
        word = "a number"
    without = tuple(core[end] for end in ("gt", "lt") if end in core)
    return f"{word} {Bounds(low, math.inf if high is None else high, without=without)}"


def _check_of(core: Core) -> Callable[[Any], Any] | None:
    """Return what checks a value before pydantic looks into it."""
    kind = core["type"]
    if kind == "dataclass":
        return partial(_check_keys, core["cls"], _needs(core["schema"]))
    if kind == "tagged-union":
        return partial(_check_tag, core["discriminator"], list(core["choices"]))
    if kind == "tuple" and "variadic_item_index" not in core:
        return partial(_check_count, len(core["items_schema"]))
    return None


def _needs(core: Core) -> dict[str, bool]:
    """Return the keys of a dataclass, and whether each is needed; a `Place` has no key."""
    while "fields" not in core:
        core = core["schema"]
    needs: dict[str, bool] = {}
    for field in core["fields"]:
        is_needed = field["schema"]["type"] != "default"
        inner = field["schema"] if is_needed else field["schema"]["schema"]
        if inner["type"] != "is-instance":
            needs[field.get("validation_alias", field["name"])] = is_needed
    return needs


def _check_keys(cls: type[Any], needs: Mapping[str, bool], given: Any) -> Any:
    """Check the keys of a mapping for a dataclass."""
    if not isinstance(given, cls):
        _check_mapping(given)
        unknown = [key for key in given if key not in needs]
        for key, is_needed in needs.items():
            if is_needed:
                _check_has(given, key, unknown)
        for key in unknown:
            allowed = ", ".join(sorted(needs)) + suggestion(key, needs)
            raise InvalidValueError(key, key, allowed)
    return given


def _check_tag(key: str, words: list[str], given: Any) -> Any:
    """Check the key that tells mappings of several kinds apart."""
    _check_mapping(given)
    _check_has(given, key, given)
    if given[key] not in words:
        allowed = " or ".join(words) + suggestion(given[key], words)
        raise InvalidValueError(key, given[key], allowed)
    return given


def _check_mapping(given: Any) -> None:
    if not isinstance(given, dict):
        raise InvalidValueError((), given, "a mapping of keys to values")


def _check_has(given: Mapping[str, Any], key: str, unknown: Iterable[str]) -> None:
    if key not in given:
        slip = suggestion(key, unknown, "mean it by")
        raise InvalidValueError(key, None, f"{key!r} is needed here{slip}")


def _check_count(count: int, given: Any) -> Any:
    if not isinstance(given, list | tuple) or len(given) != count:
        raise InvalidValueError((), given, f"{count} numbers, all finite")
    return given


# Readers.


@cache
def _reader(hint: Any, change: Callable[[Core], Core], extra: str) -> Reader:
    from pydantic import ConfigDict, TypeAdapter
    from pydantic_core import SchemaValidator

    config = ConfigDict(extra=extra, regex_engine="python-re")  # type: ignore[typeddict-item]
    # A configuration cannot be given beside a dataclass, only beside what holds it.
    core = _changed(TypeAdapter(dict[str, hint], config=config).core_schema, change)
    if core["type"] == "definitions":
        core = {**core, "schema": core["schema"]["values_schema"]}
    else:
        core = core["values_schema"]
    worded = _changed(core, _worded) if extra == "forbid" else core
    return Reader(SchemaValidator(worded), core)


def _changed(core: Any, change: Callable[[Core], Core]) -> Any:
    """Return the description of a type with that of each inner type changed."""
    if isinstance(core, list):
        return [_changed(one, change) for one in core]
    if not isinstance(core, dict):
        return core
    made = {key: _changed(value, change) for key, value in core.items()}
    return change(made) if isinstance(made.get("type"), str) else made


def file_reader(hint: Any) -> Reader:
    """Return the reader of values in files that people write, where no text is empty."""
    return _reader(hint, _written, "forbid")


def read(hint: Any, value: Any, about: str = "") -> Any:
    """Return a value as a type, or raise an `InvalidValueError` that names the key after `about`."""
    return _reader(hint, _exact, "forbid").read(value, partial(_refusal, about))


def read_entry(hint: Any, entry: Any) -> Any:
    """Return an entry of a form as a type, numbers also as text."""
    return _reader(hint, dict, "forbid").read(entry, partial(_refusal, "value"))


def read_logged(hint: Any, value: Any) -> Any:
    """Return what some version wrote into a log as a type; unknown keys and bounds do not count."""
    return _reader(hint, _unbounded, "ignore").read(value, partial(_refusal, ""))


def _refusal(about: str, path: KeyPath, given: object, allowed: str) -> InvalidValueError:
    return InvalidValueError(f"{about}{key_text(path)}", given, allowed)


def unknown_keys(given: Mapping[str, Any], read: Mapping[str, Any], above: str = "") -> list[str]:
    """Return the keys of what a log holds that the value which was read from it does not have."""
    found: list[str] = []
    for key, value in given.items():
        if key not in read:
            found.append(above + key)
        elif isinstance(value, dict) and isinstance(read[key], dict):
            found += unknown_keys(value, read[key], f"{above}{key}.")
    return found
