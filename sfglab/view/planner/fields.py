"""Fields of the inspector: values of an object or of the scene, and the edits that they make.

The fields are derived from the types of the model, so a new field of the model needs no code here. The model
checks each value. The module does not depend on widgets.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
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
    from collections.abc import Callable, Iterable, Iterator

    from sfglab.spatial.scene.editor import Editor

_NONE = "none"
_UNITS = {"_m_s2": "m/s²", "_rad_s": "rad/s", "_m_s": "m/s", "_m": "m", "_s": "s"}
_DECIMALS_M = 6
_DECIMALS_DEG = 2
_Id = int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """A field of the inspector: a text, a number from zero on, three numbers, or one of a few words."""

    key: str  #: Name of the field, unique for an object.
    label: str  #: Label, with unit.
    value: Any  #: Current value: str, float or three floats.
    edit: Callable[[Editor, Any], object]  #: Edits the scene so that the field has a new value.
    choices: tuple[str, ...] = ()  #: Words to choose from; empty: any value.
    hint: str = ""  #: Explanation.
    enabled: bool = True  #: Whether the field can be changed now.


def fields_of(scene: Scene, id_: int) -> tuple[Field, ...]:
    """Return the fields of an object, or of the scene itself for `ROOT`."""
    if id_ == ROOT:
        return tuple(_of_scene(scene))
    return tuple(_of_object(scene, scene.get(id_)))


def _of_scene(scene: Scene) -> Iterator[Field]:
    docs = field_docs(SceneSettings)
    for name in SETTINGS:
        yield Field(
            key=name,
            label=label_of(name),
            value=getattr(scene, name),
            edit=lambda editor, new, name=name: editor.set_scene(name, new),  # type: ignore[misc]
            hint=docs.get(name, ""),
        )


def _of_object(scene: Scene, thing: SceneObject) -> Iterator[Field]:
    docs = field_docs(type(thing))
    yield _field(thing, "name", thing.name, hint=docs.get("name", ""))
    if isinstance(thing, WaypointObject):
        yield Field(
            key="time_s",
            label="time (s)",
            value=thing.time_ns / NS_PER_S,
            edit=lambda editor, s: editor.set_waypoint_time(thing.id, round(s * NS_PER_S)),
            hint=docs.get("time_ns", ""),
        )
    else:
        yield _parent(scene, thing)
    yield from _place(thing)
    own: Any = type(thing)
    for name, type_ in types_of(own).items():
        if name not in (*COMMON, "time_ns"):
            yield from _own(scene, thing, name, type_, docs.get(name, ""))


def _own(scene: Scene, thing: SceneObject, name: str, type_: Any, hint: str) -> Iterator[Field]:
    """Yield the fields of a property that only this kind of object has."""
    value = getattr(thing, name)
    if isinstance(value, Box | Sphere | Cylinder):
        yield from _shape(thing, name, value)
    elif choices_of(type_):
        words = tuple(choices_of(type_))
        yield _field(thing, name, plain(value), choices=words, hint=hint)
    elif type_ == int | None:
        ids = _ids(scene.all_of(AgentObject), {_NONE: None})
        more = {"choices": tuple(ids), "hint": hint}
        yield _field(thing, name, _word(ids, value), given=lambda word: ids[word], **more)
    elif type_ == float | None:
        hint = hint.replace("None", "0")
        yield _field(thing, name, value or 0.0, hint=hint, given=lambda new: new or None)
    else:
        yield _field(thing, name, value, hint=hint)


def _field(
    thing: SceneObject,
    name: str,
    value: Any,
    *,
    given: Callable[[Any], Any] = lambda value: value,
    **more: Any,
) -> Field:
    """Return the field of a property; `given` converts the field's value to the property's value."""

    def edit(editor: Editor, new: Any) -> object:
        return editor.set_property(thing.id, name, given(new))

    return Field(value=value, edit=edit, **({"key": name, "label": label_of(name)} | more))


def _parent(scene: Scene, thing: SceneObject) -> Field:
    inside = {thing.id} | {held.id for held in scene.walk(thing.id)}
    groups = (group for group in scene.all_of(Group) if group.id not in inside)
    ids = _ids(groups, {"the scene": ROOT})
    return Field(
        key="parent",
        label="inside",
        value=_word(ids, thing.parent),
        edit=lambda editor, word: editor.move(thing.id, ids[word] or ROOT),
        choices=tuple(ids),
        hint="The place in the scene stays.",
    )


def _ids(things: Iterable[SceneObject], first: dict[str, _Id]) -> dict[str, _Id]:
    """Return the entries `first`, and after them the ids of objects by title."""
    return first | {title_of(thing): thing.id for thing in things}


def _word(ids: dict[str, _Id], wanted: _Id) -> str:
    return next(word for word, id_ in ids.items() if id_ == wanted)


def _shape(thing: SceneObject, name: str, shape: Shape) -> Iterator[Field]:
    as_shape = partial(_as_shape, shape=shape)
    yield _field(thing, name, shape.kind, choices=SHAPES, given=as_shape)
    docs = field_docs(type(shape))
    own = plain(shape)
    for key, size in own.items():
        if key == "kind":
            continue
        yield _field(
            thing,
            name,
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
    aligned = isinstance(thing, WaypointObject) and thing.align is not Align.NONE
    pose = thing.pose
    exact_deg = yaw_pitch_roll_deg(pose)

    def put(editor: Editor, typed: Vec3) -> object:
        position_m = _kept(typed, pose.position_m, _DECIMALS_M)
        return editor.set_pose(thing.id, Pose.at(position_m, pose.quat_xyzw))

    def turn(editor: Editor, typed: Vec3) -> object:
        angles_deg = _kept(typed, exact_deg, _DECIMALS_DEG)
        return editor.set_pose(thing.id, _turned(pose, angles_deg))

    yield Field(
        key="position",
        label="position (m)",
        value=_rounded(pose.position_m, _DECIMALS_M),
        edit=put,
        hint="x, y and z in the parent's frame",
    )
    yield Field(
        key="angles",
        label="turn (°)",
        value=_rounded(exact_deg, _DECIMALS_DEG),
        edit=turn,
        hint="aligned to the path: see align" if aligned else "about z, then y, then x",
        enabled=not aligned,
    )


def yaw_pitch_roll_deg(pose: Pose) -> Vec3:
    """Return an orientation as turns about z, then y, then x; at a pitch of 90 degrees the roll is zero."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")
        yaw, pitch, roll = Rotation.from_quat(pose.quat_xyzw).as_euler("ZYX", degrees=True)
    return (yaw, pitch, roll)


def _turned(pose: Pose, angles_deg: Vec3) -> Pose:
    from scipy.spatial.transform import Rotation

    return Pose.from_rotation(pose.position_m, Rotation.from_euler("ZYX", angles_deg, degrees=True))


def _rounded(values: Iterable[float], decimals: int) -> Vec3:
    x, y, z = (round(float(value), decimals) + 0.0 for value in values)  # no -0.0
    return (x, y, z)


def _kept(typed: Vec3, exact: Vec3, decimals: int) -> Vec3:
    """Return the numbers that the user typed, and the exact values for the others, which the field shows rounded."""
    values = zip(typed, _rounded(exact, decimals), exact, strict=True)
    x, y, z = (old if new == shown else new for new, shown, old in values)
    return (x, y, z)
