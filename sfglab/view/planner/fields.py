"""Fields of the inspector: values of an object or of the scene, and the edits that they make.

They follow from the types of the model, so a new field of the model has its field here at once. The model
checks each value. This module knows no widgets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.fields import choices_of, field_docs, types_of
from sfglab.spatial.poses import Pose, Vec3
from sfglab.spatial.scene.model import (
    COMMON,
    ROOT,
    SHAPES,
    AgentObject,
    Box,
    Cylinder,
    Group,
    SceneObject,
    Shape,
    Sphere,
    WaypointObject,
    plain,
)
from sfglab.spatial.scene.tree import SETTINGS, Scene, SceneSettings
from sfglab.spatial.trajectory.path import Align
from sfglab.units import NS_PER_S
from sfglab.view.planner.looks import title_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from sfglab.spatial.scene.editor import Editor

_NONE = "none"
_UNITS = {"_m_s2": "m/s²", "_rad_s": "rad/s", "_m_s": "m/s", "_m": "m", "_s": "s"}
_DECIMALS = 6
_DECIMALS_DEG = 2


class FieldKind(Enum):
    """Widget of a field."""

    TEXT = "text"  #: A line of text.
    NUMBER = "number"  #: A number from zero on.
    VECTOR = "vector"  #: Three numbers.
    CHOICE = "choice"  #: One of a few words.
    SWITCH = "switch"  #: Yes or no.


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A field of the inspector."""

    key: str  #: Name of the field, unique for an object.
    label: str  #: Label, with unit.
    kind: FieldKind  #: Widget of the field.
    value: Any  #: Current value: str, float, three floats, or bool.
    edit: Callable[[Editor, Any], object]  #: Edits the scene so that the field has a new value.
    choices: tuple[str, ...] = ()  #: Words of a CHOICE.
    hint: str = ""  #: Explanation.
    enabled: bool = True  #: Whether it can be changed now.


def fields_of(scene: Scene, id_: int) -> tuple[Field, ...]:
    """Return the fields of an object, or of the scene itself for `ROOT`."""
    if id_ == ROOT:
        return tuple(_of_scene(scene))
    return tuple(_of_object(scene, scene.get(id_)))


def _of_scene(scene: Scene) -> Iterator[Field]:
    docs = field_docs(SceneSettings)
    for name in SETTINGS:
        value = getattr(scene, name)
        yield Field(
            key=name,
            label=label_of(name),
            kind=FieldKind.TEXT if isinstance(value, str) else FieldKind.NUMBER,
            value=value,
            edit=lambda editor, new, name=name: editor.set_scene(name, new),  # type: ignore[misc]
            hint=docs.get(name, ""),
        )


def _of_object(scene: Scene, thing: SceneObject) -> Iterator[Field]:
    docs = field_docs(type(thing))
    yield _field(thing, "name", FieldKind.TEXT, thing.name, hint=docs.get("name", ""))
    if isinstance(thing, WaypointObject):
        yield Field(
            key="time_s",
            label="time (s)",
            kind=FieldKind.NUMBER,
            value=_rounded(thing.time_ns / NS_PER_S),
            edit=lambda editor, s: editor.set_waypoint_time(thing.id, round(s * NS_PER_S)),
            hint=docs.get("time_ns", ""),
        )
    else:
        yield _parent(scene, thing)
    yield from _place(thing)
    own: Any = type(thing)
    for name, hint in types_of(own).items():
        if name not in (*COMMON, "time_ns"):
            yield from _own(scene, thing, name, hint, docs.get(name, ""))


def _own(scene: Scene, thing: SceneObject, name: str, type_: Any, hint: str) -> Iterator[Field]:
    """Yield the fields of a property that only this kind of object has."""
    value = getattr(thing, name)
    if isinstance(value, Box | Sphere | Cylinder):
        yield from _shape(thing, name, value)
    elif choices_of(type_):
        words = tuple(choices_of(type_))
        yield _field(thing, name, FieldKind.CHOICE, plain(value), choices=words, hint=hint)
    elif type_ == int | None:
        yield _agent(scene, thing, name, hint)
    elif type_ == float | None:
        yield _field(
            thing,
            name,
            FieldKind.SWITCH,
            value is not None,
            key=f"{name}?",
            label=f"{name.partition('_')[0]} limit",
            hint=hint,
            given=lambda on: (value or 1.0) if on else None,
        )
        enabled = value is not None
        yield _field(thing, name, FieldKind.NUMBER, value or 0.0, hint=hint, enabled=enabled)
    else:
        yield _field(thing, name, FieldKind.NUMBER, value, hint=hint)


def _field(
    thing: SceneObject,
    name: str,
    kind: FieldKind,
    value: Any,
    *,
    given: Callable[[Any], Any] = lambda value: value,
    **more: Any,
) -> Field:
    """Return the field of a property; `given` returns the property's value for the field's."""

    def edit(editor: Editor, new: Any) -> object:
        return editor.set_property(thing.id, name, given(new))

    return Field(
        kind=kind, value=value, edit=edit, **({"key": name, "label": label_of(name)} | more)
    )


def _agent(scene: Scene, thing: SceneObject, name: str, hint: str) -> Field:
    ids: dict[str, int | None] = {_NONE: None}
    ids |= {title_of(agent): agent.id for agent in scene.all_of(AgentObject)}
    value = _word(ids, getattr(thing, name))
    more = {"choices": tuple(ids), "hint": hint}
    return _field(thing, name, FieldKind.CHOICE, value, given=lambda word: ids[word], **more)


def _parent(scene: Scene, thing: SceneObject) -> Field:
    inside = {held.id for held in scene.walk(thing.id)} | {thing.id}
    ids = {"the scene": ROOT}
    ids |= {title_of(group): group.id for group in scene.all_of(Group) if group.id not in inside}
    return Field(
        key="parent",
        label="inside",
        kind=FieldKind.CHOICE,
        value=_word(ids, thing.parent),
        edit=lambda editor, word: editor.move(thing.id, ids[word]),
        choices=tuple(ids),
        hint="The place in the scene stays.",
    )


def _word(ids: Mapping[str, int | None], wanted: int | None) -> str:
    return next(word for word, id_ in ids.items() if id_ == wanted)


def _shape(thing: SceneObject, name: str, shape: Shape) -> Iterator[Field]:
    docs = field_docs(type(shape))
    yield _field(
        thing,
        name,
        FieldKind.CHOICE,
        shape.kind,
        choices=SHAPES,
        given=partial(_as_shape, shape=shape),
    )
    own = plain(shape)
    for key, size in own.items():
        if key == "kind":
            continue
        yield _field(
            thing,
            name,
            FieldKind.VECTOR if isinstance(size, list) else FieldKind.NUMBER,
            tuple(size) if isinstance(size, list) else size,
            key=f"{name}.{key}",
            label=label_of(key),
            hint=docs.get(key, ""),
            given=lambda new, key=key: own | {key: new},  # type: ignore[misc]
        )


def _as_shape(kind: str, shape: Shape) -> Shape:
    """Return a shape of another kind with about the same size."""
    if isinstance(shape, Box):
        radius_m = min(shape.size_m[:2]) / 2.0
        height_m = shape.size_m[2]
    else:
        radius_m = shape.radius_m
        height_m = shape.height_m if isinstance(shape, Cylinder) else 2.0 * radius_m
    if kind == "box":
        return Box(size_m=(2.0 * radius_m, 2.0 * radius_m, height_m))
    if kind == "sphere":
        return Sphere(radius_m=radius_m)
    return Cylinder(radius_m=radius_m, height_m=height_m)


def label_of(name: str) -> str:
    """Return the name of a property in words, with its unit."""
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return f"{name.removesuffix(ending).replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def _place(thing: SceneObject) -> Iterator[Field]:
    position: Vec3 = _rounded3(thing.pose.position_m)
    exact_deg = yaw_pitch_roll_deg(thing.pose)
    angles: Vec3 = _rounded3(exact_deg, _DECIMALS_DEG)
    aligned = isinstance(thing, WaypointObject) and thing.align is not Align.NONE

    def put(editor: Editor, value: Vec3) -> object:
        kept = _kept(value, position, thing.pose.position_m)
        return editor.set_pose(thing.id, Pose.at(kept, thing.pose.quat_xyzw))

    def turn(editor: Editor, value: Vec3) -> object:
        return editor.set_pose(thing.id, _turned(thing.pose, _kept(value, angles, exact_deg)))

    yield Field(
        key="position",
        label="position (m)",
        kind=FieldKind.VECTOR,
        value=position,
        edit=put,
        hint="x, y and z in the parent's frame",
    )
    yield Field(
        key="angles",
        label="turn (°)",
        kind=FieldKind.VECTOR,
        value=angles,
        edit=turn,
        hint="aligned to the path: see align" if aligned else "about z, then y, then x",
        enabled=not aligned,
    )


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


def _turned(pose: Pose, angles_deg: Vec3) -> Pose:
    from scipy.spatial.transform import Rotation

    return Pose.from_rotation(pose.position_m, Rotation.from_euler("ZYX", angles_deg, degrees=True))


def _rounded(value: float, decimals: int = _DECIMALS) -> float:
    return round(value, decimals) + 0.0  # no -0.0


def _rounded3(values: Vec3, decimals: int = _DECIMALS) -> Vec3:
    x, y, z = (_rounded(value, decimals) for value in values)
    return (x, y, z)


def _kept(typed: Vec3, shown: Vec3, exact: Vec3) -> Vec3:
    """Return the typed numbers, and the exact ones that were not typed: the field shows them rounded."""
    values = zip(typed, shown, exact, strict=True)
    x, y, z = (old if new == seen else new for new, seen, old in values)
    return (x, y, z)
