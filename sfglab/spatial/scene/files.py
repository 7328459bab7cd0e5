"""Scenes as YAML files: read strictly, with file and line of what is refused; saved whole or not at all.

The same scene always gives the same bytes, and a small edit a small difference: objects stand in the tree's
order, one key a line, a waypoint on one line; what has its default value is left out. Numbers are the shortest
that read back as the same float.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, fields, make_dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from sfglab.documents import Document, DocumentError, ReadAs
from sfglab.errors import InvalidValueError
from sfglab.fields import between, bounds
from sfglab.files import read_text, write_files
from sfglab.spatial.poses import Pose, PoseError
from sfglab.spatial.scene.objects import (
    KINDS,
    ROOT,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Draft, Scene
from sfglab.spatial.trajectory.path import LATEST_NS, Align
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FORMAT = 1  #: The version of the file format.
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./()+-]*( [A-Za-z0-9_./()+-]+)*")
_NO_TEXT = frozenset({"y", "n", "yes", "no", "on", "off", "true", "false", "null"})


def scene_text(scene: Scene) -> str:
    """Return a scene as the text of a YAML file."""
    lines = [f"sfglab_scene: {FORMAT}"]
    lines += [f"{p.name}: {_scalar(getattr(scene, p.name))}" for p in SCENE_PROPERTIES]
    lines.append(f"next_id: {scene.next_id}")
    lines.append("objects:" if scene.objects else "objects: []")
    for thing in scene.walk():
        if not isinstance(thing, WaypointObject):
            lines += _object_lines(scene, thing)
    return "\n".join(lines) + "\n"


def _object_lines(scene: Scene, thing: SceneObject) -> Iterator[str]:
    yield f"- id: {thing.id}"
    yield f"  kind: {thing.kind}"
    yield f"  name: {_scalar(thing.name)}"
    if thing.parent != ROOT:
        yield f"  parent: {thing.parent}"
    if thing.pose != Pose():
        yield f"  pose: {{{_pose_text(thing.pose)}}}"
    for key, value in _said(thing):
        yield f"  {key}: {_scalar(value)}"
    held = [
        w
        for w in (scene.objects[i] for i in scene.held_by(thing.id))
        if isinstance(w, WaypointObject)
    ]
    if held:
        yield "  waypoints:"
        yield from (f"  - {{{_waypoint(waypoint)}}}" for waypoint in held)


def _waypoint(waypoint: WaypointObject) -> str:
    sec, ns = divmod(waypoint.time_ns, NS_PER_S)
    fraction = f"{ns:09d}".rstrip("0") or "0"
    parts = [f"id: {waypoint.id}", f"time_s: {sec}.{fraction}", _pose_text(waypoint.pose)]
    parts += [f"{key}: {_scalar(value)}" for key, value in _said(waypoint)]
    if waypoint.name:
        parts.append(f"name: {_scalar(waypoint.name)}")
    return ", ".join(parts)


def _said(thing: SceneObject) -> Iterator[tuple[str, Any]]:
    """Yield properties, plain, that are not what they are when nothing is said."""
    defaults = {f.name: f.default for f in fields(thing)}
    for prop in thing.properties:
        value = getattr(thing, prop.name)
        if value != defaults[prop.name]:
            yield prop.name, prop.plain(value)


def _pose_text(pose: Pose) -> str:
    return f"xyz_m: {_scalar(pose.position_m)}, quat_xyzw: {_scalar(pose.quat_xyzw)}"


def _scalar(value: Any) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_scalar(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_scalar, value)) + "]"
    return "null" if value is None else str(value)


def _number(value: float) -> str:
    """Return the shortest text that YAML 1.1 reads as this float: it wants a point before an exponent."""
    digits = repr(value + 0.0)  # no -0.0
    if "." not in digits and "e" in digits:
        return digits.replace("e", ".0e")
    return digits


def _text(value: str) -> str:
    if _PLAIN.fullmatch(value) and value.lower() not in _NO_TEXT:
        return value
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseKeys:
    """A pose in the parent."""

    xyz_m: tuple[float, float, float]  #: Position along x, y and z.
    #: Orientation, of length 1.
    quat_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        try:
            _pose(self)
        except PoseError as error:  # the numbers are finite, so it is the quaternion's length
            allowed = "a quaternion of length 1"
            raise InvalidValueError("quat_xyzw", list(self.quat_xyzw), allowed) from error


def _pose(keys: PoseKeys) -> Pose:
    return Pose.at(keys.xyz_m, keys.quat_xyzw)


@dataclass(frozen=True, slots=True, kw_only=True)
class WaypointKeys(PoseKeys):
    """Where a trajectory is at a time."""

    id: int = field(metadata=bounds(1))  #: Never given to another object.
    #: Above the previous waypoint's.
    time_s: float = field(metadata=bounds(0, LATEST_NS // NS_PER_S))
    name: str = ""  #: The name, if it has one.
    #: The direction of its x axis; unless none, the orientation is derived.
    align: Align = Align.NONE


@dataclass(frozen=True, slots=True, kw_only=True)
class _SceneKeys:
    """A scene for `sfglab plan`: agents, obstacles, zones and trajectories in one tree."""

    sfglab_scene: Literal[1]  #: Version of the format.
    name: Annotated[str, SCENE_PROPERTIES[0]] = "scene"  #: For people.
    #: The frame of what stands at the top, for messages.
    frame_id: Annotated[str, SCENE_PROPERTIES[1]] = "map"
    #: Least distance of agents beyond their radii.
    margin_m: Annotated[float, SCENE_PROPERTIES[2]] = 0.1
    next_id: int = field(metadata=bounds(1))  #: A number above every id that was ever given.
    objects: tuple[Any, ...] = ()  #: The objects.


@dataclass(frozen=True, slots=True, kw_only=True)
class _ObjectKeys:
    """An object of a scene."""

    id: int = field(metadata=bounds(1))  #: Never given to another object.
    name: str  #: For people; several objects may share one.
    parent: int = between(ROOT)  #: Id of the object that holds it; 0: none.
    #: Pose in its parent; by default that of the parent.
    pose: Annotated[Pose, ReadAs(PoseKeys, _pose)] = field(default_factory=Pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class _TrajectoryKeys(_ObjectKeys):
    """A trajectory, which holds its waypoints."""

    waypoints: tuple[WaypointKeys, ...] = ()  #: In order of time.


@cache
def scene_keys() -> type[Any]:
    """Return the class of a scene file, whose objects are told apart by their kind."""
    from pydantic import Field

    kinds = tuple(_object_keys(kind) for kind in KINDS.values() if kind is not WaypointObject)
    one: Any = Annotated[Union[kinds], Field(discriminator="kind")]  # noqa: UP007  # of a tuple
    objects = ("objects", tuple[one, ...], field(default=()))
    said = {"__doc__": _SceneKeys.__doc__}
    return make_dataclass(
        "Scene", [objects], bases=(_SceneKeys,), namespace=said, frozen=True, kw_only=True
    )


def _object_keys(kind: type[SceneObject]) -> type[Any]:
    """Return the class of a kind of object in a file, with the object's own properties."""
    kept = {f.name: f for f in fields(kind)}
    keys: list[Any] = [("kind", Literal[kind.kind])]
    for prop in kind.properties:
        usual = kept[prop.name]
        left_out: Any = field(default=usual.default, default_factory=usual.default_factory)
        keys.append((prop.name, Annotated[Any, prop], left_out))
    base = _TrajectoryKeys if kind is TrajectoryObject else _ObjectKeys
    said = {"__doc__": kind.__doc__, "documented": kind}
    return make_dataclass(
        kind.__name__, keys, bases=(base,), namespace=said, frozen=True, kw_only=True
    )


def read_scene(text: str, *, file: str = "scene.yaml") -> Scene:
    """Return the scene of a YAML text, its waypoints aligned; its file's name is for messages.

    Raises:
        SceneError: It is not YAML, has unknown, doubled or missing keys, or says what a scene cannot be: a
            doubled id, a parent in its child, times that collide or run backwards, a bad number or quaternion.
    """
    try:
        return _scene(Document(text, file))
    except DocumentError as error:
        raise SceneError(str(error.place), error.given, error.allowed) from error


def _scene(document: Document) -> Scene:
    keys: Any = document.read(scene_keys())
    draft = Draft(Scene(name=keys.name, frame_id=keys.frame_id, margin_m=keys.margin_m))
    _insert_all(draft, list(_objects(document, keys.objects)))
    scene = draft.scene()
    if keys.next_id < scene.next_id:
        allowed = f"a number above every id, from {scene.next_id}"
        raise document.refusal(("next_id",), keys.next_id, allowed)
    return replace(scene, next_id=keys.next_id)


Placed = tuple[str, SceneObject]  #: The place in the file, and the object.


def _objects(document: Document, objects: tuple[Any, ...]) -> Iterator[Placed]:
    """Yield an object and, for a trajectory, its waypoints, each with its place."""
    for position, keys in enumerate(objects):
        path = ("objects", position)
        kind = KINDS[keys.kind]
        thing = kind(**{f.name: getattr(keys, f.name) for f in fields(kind)})
        yield str(document.place(path)), thing
        if kind is TrajectoryObject:
            before_ns = -1
            for number, point in enumerate(keys.waypoints):
                place = (*path, "waypoints", number)
                waypoint = _waypoint_of(point, thing.id)
                if waypoint.time_ns <= before_ns:
                    allowed = f"a time above the previous waypoint's, {before_ns / NS_PER_S}"
                    raise document.refusal((*place, "time_s"), point.time_s, allowed)
                before_ns = waypoint.time_ns
                yield str(document.place(place)), waypoint


def _waypoint_of(keys: WaypointKeys, parent: int) -> WaypointObject:
    time_ns = round(keys.time_s * NS_PER_S)
    pose = _pose(keys)
    return WaypointObject(
        id=keys.id, name=keys.name, parent=parent, pose=pose, time_ns=time_ns, align=keys.align
    )


def _insert_all(draft: Draft, objects: list[Placed]) -> None:
    """Put objects into a draft: parents before children, agents before trajectories, siblings in order."""
    by_id: dict[int, Placed] = {}
    for place, thing in objects:
        if thing.id in by_id:
            raise SceneError(
                place, f"id {thing.id}", f"an id of its own; {by_id[thing.id][0]} has this one"
            )
        by_id[thing.id] = (place, thing)
    held: dict[int, list[int]] = {}
    for _, thing in objects:
        held.setdefault(thing.parent, []).append(thing.id)
    pending = [ROOT]
    while pending:
        for id_ in held.pop(pending.pop(), ()):
            _insert(draft, *by_id[id_])
            pending.append(id_)
    for lost in (id_ for ids in held.values() for id_ in ids):
        _refuse_loop(by_id, lost)
        _insert(draft, *by_id[lost])  # which says that there is no such parent
    for place, thing in by_id.values():
        if isinstance(thing, TrajectoryObject) and thing.agent is not None:
            _done(draft.put, place, thing)


def _refuse_loop(by_id: dict[int, Placed], start: int) -> None:
    chain: list[int] = []
    above = start
    while above in by_id:
        if above in chain:
            loop = " in ".join(map(str, [*chain[chain.index(above) :], above]))
            raise SceneError(f"{by_id[above][0]}, parent", f"a loop, {loop}", "a tree")
        chain.append(above)
        above = by_id[above][1].parent


def _insert(draft: Draft, place: str, thing: SceneObject) -> None:
    if isinstance(thing, TrajectoryObject):
        thing = replace(thing, agent=None)  # agents may stand further down
    _done(draft.insert, place, thing)


def _done(edit: Callable[[SceneObject], None], place: str, thing: SceneObject) -> None:
    try:
        edit(thing)
    except SceneError as error:
        raise SceneError(f"{place}: {error.place}", error.given, error.allowed) from error


def load_scene(path: Path | str) -> Scene:
    """Read a scene file, such as ``data/scenes/hall.yaml``; SceneError says where and how it is wrong."""
    path = Path(path)
    try:
        text = read_text(path)
    except InvalidValueError as error:
        raise SceneError(path.name, error.given, error.allowed) from error
    return read_scene(text, file=path.name)


def save_scene(scene: Scene, path: Path) -> None:
    """Write a scene into a file; at any moment the file holds either the old scene or the new one.

    Raises:
        SceneError: The file cannot be written; what was there is still there.
    """
    try:
        write_files({path: scene_text(scene)})
    except InvalidValueError as error:
        raise SceneError(path.name, error.given, error.allowed) from error
