"""Findings about the editor's files, and what several checks ask of a value."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from sfglab.documents import Place, suggestion
from sfglab.fleet.border import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


_EXTENSION = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]*\.[A-Za-z0-9][A-Za-z0-9._-]*")
"""``publisher.name``, as in the marketplace."""

_VARIABLE = re.compile(r"\$\{([^}]*)\}")
_VARIABLES = ("file", "fileDirname", "workspaceFolder", "localWorkspaceFolder", "containerWorkspaceFolder")
_COMMANDS = ("pickMyProcess", "pickProcess")  # CodeLLDB's manual, "Pick Process Command"


def fault(file: str, key: str, what: str, why: str = "VS Code passes over it, or shows an error") -> Finding:
    """Return an error at a key of a file."""
    return Finding(severity=Severity.ERROR, code="editor", place=Place(file=file, key=key), what=what, why=why)


def bad_keys(
    value: Mapping[str, Any], file: str, key: str, *, known: Iterable[str], needed: Iterable[str] = ()
) -> Iterator[Finding]:
    """Find keys that nobody reads and those that are missing."""
    known = tuple(known)
    prefix = f"{key}." if key else ""
    for name in value:
        if name not in known:
            yield fault(file, f"{prefix}{name}", f"unknown key {name!r}{suggestion(name, known)}")
    for name in needed:
        if value.get(name) in (None, "", []):
            yield fault(file, f"{prefix}{name}", f"nothing is given, allowed: {name} of the reference")


def bad_variables(value: Any, file: str, key: str, inputs: Iterable[str]) -> Iterator[Finding]:
    """Find ``${...}`` that VS Code does not replace, and inputs that nobody defines."""
    inputs = tuple(inputs)
    for text in texts(value):
        for name in _VARIABLE.findall(text):
            kind, _, rest = name.partition(":")
            allowed = {"input": inputs, "command": _COMMANDS, "env": (rest,)}.get(kind, _VARIABLES)
            if (rest or kind) not in allowed:
                near = suggestion(rest or kind, allowed)
                yield fault(file, key, f"given ${{{name}}}, allowed: {', '.join(allowed) or 'none'}{near}")


def bad_extensions(file: str, key: str, ids: Any) -> Iterator[Finding]:
    """Find what is no extension's id, or stands there twice."""
    if not isinstance(ids, list):
        yield fault(file, key, f"given {ids!r}, allowed: a list of extensions")
        return
    for position, name in enumerate(ids):
        if not isinstance(name, str) or not _EXTENSION.fullmatch(name):
            yield fault(file, f"{key}[{position}]", f"given {name!r}, allowed: publisher.name")
        elif name in ids[:position]:
            yield fault(file, f"{key}[{position}]", f"{name} stands there twice")


def texts(value: Any) -> Iterator[str]:
    """Yield every text inside a value of JSON."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for inner in value.values():
            yield from texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from texts(inner)


def entries(value: Any) -> list[tuple[int, dict[str, Any]]]:
    """Return the objects of a list with their positions; nothing of what is no list."""
    listed = value if isinstance(value, list) else []
    return [(position, entry) for position, entry in enumerate(listed) if isinstance(entry, dict)]


def bad_entries(value: Any, file: str, key: str) -> Iterator[Finding]:
    """Find what is no list of objects."""
    if not isinstance(value, list):
        yield fault(file, key, f"given {value!r}, allowed: a list of objects")
    elif len(entries(value)) < len(value):
        yield fault(file, key, "an entry is no object, allowed: a list of objects")


def mapping_at(value: Any, *keys: str) -> dict[str, Any]:
    """Return the object below some keys, empty where there is none."""
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value if isinstance(value, dict) else {}


def listed(value: Any) -> list[Any]:
    """Return a list, of one value where only that is given."""
    return value if isinstance(value, list) else [] if value is None else [value]
