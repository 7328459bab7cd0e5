"""A field of a form: what is typed, and the edit it makes; and the fields of a kind's own properties. Pure.

Refuses to know names, places and widgets.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene import AgentObject, SetProperty
from sfglab.spatial.trajectory import Box, Cylinder, Sphere

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.spatial.scene import Command, Property, Scene, SceneObject
    from sfglab.spatial.trajectory import Shape


_NONE = "none"
_SHAPES = ("box", "sphere", "cylinder")
_UNITS = {"_m_s2": "m/s²", "_rad_s": "rad/s", "_m_s": "m/s", "_m": "m", "_s": "s"}


class FieldKind(Enum):
    """How a field is typed."""

    TEXT = "text"  #: A line of text.
    NUMBER = "number"  #: A number from zero on.
    VECTOR = "vector"  #: Three numbers.
    CHOICE = "choice"  #: One of a few words.
    SWITCH = "switch"  #: Yes or no.


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One field."""

    key: str  #: Its name among the object's fields.
    label: str  #: What people read, with unit.
    kind: FieldKind  #: How it is typed.
    value: Any  #: What stands in it: str, float, three floats, or bool.
    command: Callable[[Any], Command]  #: From a new value to the edit.
    choices: tuple[str, ...] = ()  #: Of a CHOICE.
    hint: str = ""  #: What is allowed.
    enabled: bool = True  #: Whether it can be changed now.


def property_fields(scene: Scene, thing: SceneObject, prop: Property) -> Iterator[Field]:
    """Yield the fields of one property of an object."""
    value = getattr(thing, prop.name)
    if isinstance(value, Box | Sphere | Cylinder):
        yield from _of_shape(thing, prop, value)
    elif prop.choices:
        yield _field(thing, prop, FieldKind.CHOICE, value.value, choices=prop.choices)
    elif _refers(prop):
        yield _of_reference(scene, thing, prop)
    elif _optional(prop):
        yield _field(
            thing,
            prop,
            FieldKind.SWITCH,
            value is not None,
            key=f"{prop.name}?",
            label=f"{prop.name.split('_')[0]} limit",
            plain=lambda on: (value or 1.0) if on else None,
        )
        yield _field(thing, prop, FieldKind.NUMBER, value or 0.0, enabled=value is not None)
    else:
        kind = FieldKind.TEXT if isinstance(value, str) else FieldKind.NUMBER
        yield _field(thing, prop, kind, value)


def _field(
    thing: SceneObject,
    prop: Property,
    kind: FieldKind,
    value: Any,
    *,
    plain: Callable[[Any], Any] = lambda value: value,
    **more: Any,
) -> Field:
    """Return the field of one property; `plain` makes the property's value of the field's."""
    given = {"key": prop.name, "label": label_of(prop.name), "hint": prop.allowed} | more
    return Field(
        kind=kind,
        value=value,
        command=lambda new: SetProperty(id=thing.id, key=prop.name, value=plain(new)),
        **given,
    )


def _of_reference(scene: Scene, thing: SceneObject, prop: Property) -> Field:
    ids: dict[str, int | None] = {_NONE: None} | {titled(a): a.id for a in scene.all_of(AgentObject)}
    value = next(word for word, id_ in ids.items() if id_ == getattr(thing, prop.name))
    return _field(thing, prop, FieldKind.CHOICE, value, choices=tuple(ids), plain=lambda word: ids[word])


def _of_shape(thing: SceneObject, prop: Property, shape: Shape) -> Iterator[Field]:
    plain = prop.plain(shape)
    word = plain["kind"]
    yield _field(thing, prop, FieldKind.CHOICE, word, choices=_SHAPES, plain=lambda new: _as_shape(new, shape))
    for key, size in plain.items():
        if key != "kind":
            kind = FieldKind.VECTOR if isinstance(size, tuple) else FieldKind.NUMBER
            yield _field(
                thing,
                prop,
                kind,
                size,
                key=f"{prop.name}.{key}",
                label=label_of(key),
                plain=partial(_resized, plain, key),
            )


def _resized(plain: dict[str, Any], key: str, size: Any) -> dict[str, Any]:
    return plain | {key: size}


def _as_shape(word: str, shape: Shape) -> dict[str, Any]:
    """Return a body of another form that is about as large."""
    if isinstance(shape, Box):
        radius_m, height_m = min(shape.size_m[:2]) / 2.0, shape.size_m[2]
    else:
        radius_m = shape.radius_m
        height_m = shape.height_m if isinstance(shape, Cylinder) else 2.0 * radius_m
    sizes: dict[str, dict[str, Any]] = {
        "box": {"size_m": (2.0 * radius_m, 2.0 * radius_m, height_m)},
        "sphere": {"radius_m": radius_m},
        "cylinder": {"radius_m": radius_m, "height_m": height_m},
    }
    return {"kind": word} | sizes[word]


def _refers(prop: Property) -> bool:
    with suppress(ValueError, TypeError):
        return type(prop.parse(1)) is int
    return False


def _optional(prop: Property) -> bool:
    with suppress(ValueError, TypeError):
        return prop.parse(None) is None
    return False


def label_of(name: str) -> str:
    """Return a property's name for people, with its unit."""
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return f"{name.removesuffix(ending).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def titled(thing: SceneObject) -> str:
    """Return how an object stands in a choice: no two read alike."""
    return f"{thing.name}  #{thing.id}"
