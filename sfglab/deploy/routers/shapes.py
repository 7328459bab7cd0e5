"""Names to ask two filters with, made from their patterns: where they differ, one of these shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from sfglab.documents import Document, KeyPath, suggestion
from sfglab.fleet.border import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterable


Check: TypeAlias = Callable[[Document, KeyPath, Any], Iterator[Finding]]


def fault(  # noqa: PLR0913 - a finding has as many parts
    document: Document,
    path: KeyPath,
    what: str,
    *,
    why: str,
    remedy: str = "",
    code: str = "schema",
    severity: Severity = Severity.ERROR,
) -> Finding:
    """Return a finding at a place of a document."""
    return Finding(severity=severity, code=code, place=document.place(path), what=what, why=why, remedy=remedy)


def _wrong(document: Document, path: KeyPath, value: Any, allowed: str) -> Finding:
    what = f"given {value!r}, allowed: {allowed}"
    return fault(document, path, what, why="the configuration is refused when it is loaded")


def anything(_document: Document, _path: KeyPath, _value: Any) -> Iterator[Finding]:
    """Accept every value."""
    return iter(())


def flag(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
    """Accept true and false."""
    if not isinstance(value, bool):
        yield _wrong(document, path, value, "true or false")


def whole(low: int, high: int | None = None) -> Check:
    """Return a check for whole numbers of a range."""

    def check(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
        if isinstance(value, bool) or not isinstance(value, int):
            yield _wrong(document, path, value, "a whole number")
        elif value < low or (high is not None and value > high):
            yield _wrong(document, path, value, f"{low} to {high}" if high is not None else f"{low} or more")

    return check


def number(*, low: float = 0.0, above: bool = False) -> Check:
    """Return a check for numbers from `low`, or above it."""

    def check(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
        if isinstance(value, bool) or not isinstance(value, int | float):
            yield _wrong(document, path, value, "a number")
        elif value < low or (above and value == low):
            yield _wrong(document, path, value, f"{'above' if above else 'at least'} {low:g}")

    return check


def text(*choices: str, ignore_case: bool = False) -> Check:
    """Return a check for texts, for those among the choices if there are any."""

    def check(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
        if not isinstance(value, str):
            yield _wrong(document, path, value, "a text")
        elif choices and (value.lower() if ignore_case else value) not in choices:
            yield _wrong(document, path, value, ", ".join(choices) + suggestion(value, choices))

    return check


def listing(item: Check, *, least: int = 0) -> Check:
    """Return a check for lists of items of a shape."""

    def check(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
        if not isinstance(value, list):
            yield _wrong(document, path, value, "a list")
            return
        if len(value) < least:
            yield _wrong(document, path, value, f"a list of at least {least}")
        for position, entry in enumerate(value):
            yield from item(document, (*path, position), entry)

    return check


def mapping(keys: Mapping[str, Check], *, needed: tuple[str, ...] = (), one_of: tuple[str, ...] = ()) -> Check:
    """Return a check for mappings with these keys and no others.

    Args:
        keys: The check of each key's value.
        needed: Keys that must be there.
        one_of: Keys of which at least one must be there.
    """

    def check(document: Document, path: KeyPath, value: Any) -> Iterator[Finding]:
        if not isinstance(value, dict):
            yield _wrong(document, path, value, f"a mapping with {', '.join(keys)}")
            return
        for key in value:
            if key not in keys:
                yield _unknown(document, (*path, key), key, tuple(keys))
        for key in needed:
            if key not in value:
                yield _missing(document, (*path, key), key)
        if one_of and not any(key in value for key in one_of):
            yield _missing(document, path, " or ".join(one_of))
        for key, content in value.items():
            if key in keys:
                yield from keys[key](document, (*path, key), content)

    return check


def _unknown(document: Document, path: KeyPath, key: str, known: tuple[str, ...]) -> Finding:
    return fault(
        document,
        path,
        f"unknown key {key!r}{suggestion(key, known)}",
        why="older versions pass over it in silence, newer ones refuse the whole file",
        remedy=f"allowed here: {', '.join(known)}",
        code="unknown-key",
    )


def _missing(document: Document, path: KeyPath, key: str) -> Finding:
    return fault(
        document,
        path,
        f"{key} is missing",
        why="the configuration is refused when it is loaded",
        remedy=f"add {key}",
        code="missing-key",
    )


PLAIN = ("rt/chatter", "rt/rosout", "rt/parameter_events", "rt/local/go2/x", "rt/tf2", "ros_discovery_info")
FILLINGS = ("", "a", "a/b", "aRequest", "aReply", "a/_action/status")


def probe_names(patterns: Iterable[str]) -> tuple[str, ...]:
    """Return DDS topic names inside, at the edge of and just outside of patterns, each once and sorted.

    Args:
        patterns: Names with ``*`` as wildcard.
    """
    names = set(PLAIN)
    for pattern in patterns:
        filled = {pattern.replace("*", filling) for filling in FILLINGS}
        names |= filled
        names |= {name[:-1] for name in filled} | {f"{name}_x" for name in filled}
        names |= {f"{name[:2]}/local{name[2:]}" for name in filled} | {
            name.replace("/", "ly/", 2) for name in filled
        }
    return tuple(sorted(name for name in names if name))
