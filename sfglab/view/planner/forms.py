"""Fields of an object, or of the scene: what can be typed, in order, and the edits that it makes. Pure.

Fields follow from `KINDS[kind].properties`, so a new property of the model has its field at once. The model
checks every value; a field's range only helps people who type. Refuses to know widgets.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose, Vec3
from sfglab.spatial.scene.commands import (
    Command,
    Move,
    Rename,
    SetPose,
    SetProperty,
    SetScene,
    SetTime,
)
from sfglab.spatial.scene.objects import (
    ROOT,
    AgentObject,
    Group,
    Property,
    SceneObject,
    WaypointObject,
)
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Scene
from sfglab.spatial.trajectory.clearance import Box, Cylinder, Shape, Sphere
from sfglab.spatial.trajectory.path import Align
from sfglab.units import NS_PER_S
from sfglab.view.planner.looks import title_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

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
    ids: dict[str, int | None] = {_NONE: None} | {
        title_of(a): a.id for a in scene.all_of(AgentObject)
    }
    value = next(word for word, id_ in ids.items() if id_ == getattr(thing, prop.name))
    return _field(
        thing, prop, FieldKind.CHOICE, value, choices=tuple(ids), plain=lambda word: ids[word]
    )


def _of_shape(thing: SceneObject, prop: Property, shape: Shape) -> Iterator[Field]:
    plain = prop.plain(shape)
    word = plain["kind"]
    yield _field(
        thing,
        prop,
        FieldKind.CHOICE,
        word,
        choices=_SHAPES,
        plain=lambda new: _as_shape(new, shape),
    )
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
                plain=lambda new, key=key: plain | {key: new},  # type: ignore[misc]
            )


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


_DECIMALS = 6
_DECIMALS_DEG = 2


def fields_of(scene: Scene, id_: int) -> tuple[Field, ...]:
    """Return the fields of an object, of the scene itself where the id is `ROOT`."""
    if id_ == ROOT:
        return tuple(_of_scene(scene))
    return tuple(_of_object(scene, scene.get(id_)))


def yaw_pitch_roll_deg(pose: Pose) -> Vec3:
    """Return an orientation as turns about z, then y, then x; at a pitch of 90 degrees the roll is zero."""
    x, y, z, w = pose.quat_xyzw
    sine = max(-1.0, min(1.0, 2.0 * (w * y - z * x)))
    if abs(sine) > 1.0 - 1e-9:
        up = math.copysign(1.0, sine)
        return (math.degrees(-2.0 * up * math.atan2(x, w)), 90.0 * up, 0.0)
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return (math.degrees(yaw), math.degrees(math.asin(sine)), math.degrees(roll))


def _of_scene(scene: Scene) -> Iterator[Field]:
    for prop in SCENE_PROPERTIES:
        value = getattr(scene, prop.name)
        kind = FieldKind.TEXT if isinstance(value, str) else FieldKind.NUMBER
        yield Field(
            key=prop.name,
            label=label_of(prop.name),
            kind=kind,
            value=value,
            command=lambda new, key=prop.name: SetScene(key=key, value=new),  # type: ignore[misc]
            hint=prop.allowed,
        )


def _of_object(scene: Scene, thing: SceneObject) -> Iterator[Field]:
    yield Field(
        key="name",
        label="name",
        kind=FieldKind.TEXT,
        value=thing.name,
        command=lambda value: Rename(id=thing.id, name=value),
        hint="1 to 100 printable characters",
    )
    if isinstance(thing, WaypointObject):
        yield _time(thing)
    else:
        yield _parent(scene, thing)
    yield from _place(thing)
    for prop in thing.properties:
        yield from property_fields(scene, thing, prop)


def _time(thing: WaypointObject) -> Field:
    return Field(
        key="time_s",
        label="time (s)",
        kind=FieldKind.NUMBER,
        value=_rounded(thing.time_ns / NS_PER_S),
        command=lambda value: SetTime(id=thing.id, time_ns=round(value * NS_PER_S)),
        hint="seconds since the scene's time 0; no two waypoints share one",
    )


def _parent(scene: Scene, thing: SceneObject) -> Field:
    inside = {held.id for held in scene.walk(thing.id)} | {thing.id}
    groups = {title_of(g): g.id for g in scene.all_of(Group) if g.id not in inside}
    ids = {"the scene": ROOT, **groups}
    return Field(
        key="parent",
        label="inside",
        kind=FieldKind.CHOICE,
        value=next(word for word, id_ in ids.items() if id_ == thing.parent),
        command=lambda word: Move(id=thing.id, parent=ids[word]),
        choices=tuple(ids),
        hint="moved to another group it stays where it is in the scene",
    )


def _place(thing: SceneObject) -> Iterator[Field]:
    position: Vec3 = _rounded3(thing.pose.position_m)
    exact_deg = yaw_pitch_roll_deg(thing.pose)
    angles: Vec3 = _rounded3(exact_deg, _DECIMALS_DEG)
    aligned = isinstance(thing, WaypointObject) and thing.align is not Align.NONE

    def put(value: Vec3) -> Command:
        kept = _kept(value, position, thing.pose.position_m)
        return SetPose(id=thing.id, pose=Pose(position_m=kept, quat_xyzw=thing.pose.quat_xyzw))

    def turn(value: Vec3) -> Command:
        return SetPose(id=thing.id, pose=_turned(thing.pose, _kept(value, angles, exact_deg)))

    yield Field(
        key="position",
        label="position (m)",
        kind=FieldKind.VECTOR,
        value=position,
        command=put,
        hint="x, y and z in the parent's frame",
    )
    yield Field(
        key="angles",
        label="turn (°)",
        kind=FieldKind.VECTOR,
        value=angles,
        command=turn,
        hint="follows the path; set align to none to turn it"
        if aligned
        else "about z, then y, then x",
        enabled=not aligned,
    )


def _turned(pose: Pose, angles_deg: Vec3) -> Pose:
    from scipy.spatial.transform import Rotation

    return Pose.from_rotation(pose.position_m, Rotation.from_euler("ZYX", angles_deg, degrees=True))


def _rounded(value: float, decimals: int = _DECIMALS) -> float:
    return round(value, decimals) + 0.0  # no -0.0


def _rounded3(values: Vec3, decimals: int = _DECIMALS) -> Vec3:
    x, y, z = (_rounded(value, decimals) for value in values)
    return (x, y, z)


def _kept(typed: Vec3, shown: Vec3, exact: Vec3) -> Vec3:
    """Return what was typed, and exactly what was there where nobody typed: what a field shows is rounded."""
    x, y, z = (
        old if new == seen else new for new, seen, old in zip(typed, shown, exact, strict=True)
    )
    return (x, y, z)
