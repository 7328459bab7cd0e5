"""Properties of objects: what each may be, how it stands in a file, what it is when nothing is said.

The inspector, the commands and the file format all go by these descriptions. A property's values may be given
typed or plain, as YAML or a form has them. Refuses to know which object has which property (`objects`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene.errors import SceneError
from sfglab.spatial.trajectory import Box, Cylinder, Sphere

if TYPE_CHECKING:
    from collections.abc import Callable
    from enum import Enum

    from sfglab.spatial.trajectory import Shape


_LONGEST = 100
_SHAPES: dict[str, type[Shape]] = {"box": Box, "sphere": Sphere, "cylinder": Cylinder}


@dataclass(frozen=True, slots=True, kw_only=True)
class Property:
    """One property of a kind of object."""

    name: str  #: Its name, with unit.
    allowed: str  #: What it may be, in words.
    #: From a typed or plain value to the typed one; raises ValueError or TypeError.
    parse: Callable[[Any], Any]
    plain: Callable[[Any], Any] = lambda value: value  #: From the typed value to what stands in a file.
    #: What may be chosen from, for a form; empty where anything else is asked for.
    choices: tuple[str, ...] = ()

    def typed(self, value: Any, place: str) -> Any:
        """Return a value as the property holds it.

        Raises:
            SceneError: It is not allowed.
        """
        try:
            return self.parse(value)
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise SceneError(place, value, self.allowed) from error


def as_name(value: Any) -> str:
    """Return a name: 1 to 100 printable characters.

    Raises:
        ValueError: It is none.
    """
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST or not value.isprintable():
        raise ValueError(value)
    return value


def text(name: str) -> Property:
    """Return the property of a short text."""
    return Property(name=name, allowed=f"1 to {_LONGEST} printable characters", parse=as_name)


def length(name: str, *, optional: bool = False, zero: bool = False) -> Property:
    """Return the property of a finite number above zero.

    Args:
        name: Its name, with unit.
        optional: None is allowed, and means no limit.
        zero: Zero is allowed.
    """

    def parse(value: Any) -> float | None:
        if value is None and optional:
            return None
        number = _number(value)
        if number < 0.0 or (number == 0.0 and not zero):
            raise ValueError(value)
        return number

    allowed = "a finite number " + ("from zero" if zero else "above zero") + (", or none" if optional else "")
    return Property(name=name, allowed=allowed, parse=parse)


def choice(name: str, kind: type[Enum]) -> Property:
    """Return the property of one of an enumeration's members, in files by its value."""
    words = tuple(str(member.value) for member in kind)
    return Property(
        name=name, allowed=" or ".join(words), parse=kind, plain=lambda value: value.value, choices=words
    )


def reference(name: str, what: str) -> Property:
    """Return the property of another object's id, or of none."""

    def parse(value: Any) -> int | None:
        if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
            raise TypeError(value)
        return value

    return Property(name=name, allowed=f"the id of {what}, or none", parse=parse)


def shape(name: str) -> Property:
    """Return the property of a body: box, sphere or cylinder."""
    forms = (f"{word} with {' and '.join(f.name for f in fields(of))}" for word, of in _SHAPES.items())
    return Property(name=name, allowed=" or ".join(forms), parse=_parsed_shape, plain=_plain_shape)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError(value)
    return float(value)


def _parsed_shape(value: Any) -> Shape:
    sizes = _plain_shape(value) if isinstance(value, Box | Sphere | Cylinder) else dict(value)
    made = _SHAPES[sizes.pop("kind")]
    if sizes.keys() != {f.name for f in fields(made)}:
        raise ValueError(value)
    numbers: Any = {key: _sizes(size) if key == "size_m" else _number(size) for key, size in sizes.items()}
    return made(**numbers)


def _sizes(value: Any) -> tuple[float, float, float]:
    x, y, z = map(_number, value)
    return (x, y, z)


def _plain_shape(value: Shape) -> dict[str, Any]:
    word = next(word for word, of in _SHAPES.items() if isinstance(value, of))
    return {"kind": word} | {f.name: getattr(value, f.name) for f in fields(value)}
