"""Values of a Compose file in one form, where the specification allows several.

Source: Compose Specification, "services" and "interpolation" (2026).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator

_VARIABLE = re.compile(
    r"\$(?:\$|(?P<plain>[A-Za-z_]\w*)|\{(?P<name>[A-Za-z_]\w*)(?P<rest>[^}]*)\})"
)
_COLON = re.compile(r":(?![^{]*\})")  # between parts, not within a variable as ${A:?what to do}
_DEFAULT = re.compile(r"\$\{[A-Za-z_]\w*:?-([^}]*)\}")
_PLAIN = "plain"


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A variable in a text."""

    name: str  #: Its name.
    must_be_set: bool  #: Compose ends with an error where it is not set.
    has_default: bool  #: Something else is taken where it is not set.


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """A volume of a service."""

    source: str  #: Folder of the machine, or name of a volume; empty where it has none.
    target: str  #: Where it is in the container.
    bind: bool  #: Whether it is a folder of the machine.
    read_only: bool  #: Whether the container cannot write to it.


def scalars(value: Any, *, key: str = "") -> list[str]:
    """Return a list's texts; of entries that are mappings, the one at `key`."""
    entries = value if isinstance(value, list) else [] if value is None else [value]
    found = (entry.get(key, "") if isinstance(entry, dict) else entry for entry in entries)
    return [str(entry) for entry in found]


def named(value: Any) -> tuple[str, ...]:
    """Return the names of a list of names, or of a mapping by name."""
    return tuple(str(name) for name in value) if isinstance(value, list | dict) else ()


def environment(value: Any) -> Iterator[tuple[str, str]]:
    """Yield names and values, from a mapping or from a list of ``NAME=value``."""
    if isinstance(value, dict):
        for name, given in value.items():
            yield str(name), "" if given is None else str(given)
    else:
        for entry in scalars(value):
            name, _, given = entry.partition("=")
            yield name, given


def mounts(service: dict[str, Any]) -> Iterator[Mount]:
    """Yield a service's volumes, from their short and their long form."""
    volumes = service.get("volumes")
    for volume in volumes if isinstance(volumes, list) else []:
        if isinstance(volume, dict):
            places = {place: str(volume.get(place, "")) for place in ("source", "target")}
            bind = volume.get("type") == "bind"
            yield Mount(**places, bind=bind, read_only=volume.get("read_only") is True)
        else:
            yield _short_mount(str(volume))


def _short_mount(text: str) -> Mount:
    parts = _COLON.split(_DEFAULT.sub(lambda match: match[1], text))
    source, target, modes = [*parts, ""][:3] if len(parts) > 1 else ("", text, "")
    bind = source.startswith((".", "/", "~", "$"))
    return Mount(source=source, target=target, bind=bind, read_only="ro" in modes.split(","))


def variables(value: Any) -> Iterator[Variable]:
    """Yield the variables in all texts of a value, keys left out, as Compose leaves them."""
    if isinstance(value, dict):
        for inner in value.values():
            yield from variables(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from variables(inner)
    elif isinstance(value, str):
        yield from _variables(value)


def _variables(text: str) -> Iterator[Variable]:
    for match in _VARIABLE.finditer(text):
        name, rest = match["name"] or match["plain"], (match["rest"] or "").removeprefix(":")
        if name:
            yield Variable(
                name=name, must_be_set=rest.startswith("?"), has_default=rest.startswith(("-", "+"))
            )


def without_variables(text: str) -> str:
    """Return a text with each variable as its default, or as a word where it has none."""
    return _VARIABLE.sub(_PLAIN, _DEFAULT.sub(lambda match: match[1], text))


def references(service: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield what a service names: its key, the section where that is defined, and the name."""
    for key, section in (
        ("depends_on", "services"),
        ("networks", "networks"),
        ("secrets", "secrets"),
    ):
        for name in named(service.get(key)):
            yield key, section, name
    for mount in mounts(service):
        if mount.source and not mount.bind:
            yield "volumes", "volumes", mount.source
