"""Scenes as YAML files: read strictly, with file and line of what is refused; saved whole or not at all.

The same scene always gives the same bytes, and a small edit a small difference: objects stand in the tree's
order, one key a line, a waypoint on one line; what has its default value is left out. Numbers are the shortest
that read back as the same float.
"""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.documents import Document, DocumentError, Section, suggestion
from sfglab.errors import InvalidValueError
from sfglab.files import read_text, write_files
from sfglab.spatial.poses import Pose, PoseError
from sfglab.spatial.scene.objects import (
    KINDS,
    ROOT,
    Property,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Draft, Scene
from sfglab.spatial.trajectory.path import LATEST_NS
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

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


_LATEST_S = LATEST_NS // NS_PER_S


def read_scene(text: str, *, file: str = "scene.yaml") -> Scene:
    """Return the scene of a YAML text, its waypoints aligned; its file's name is for messages.

    Raises:
        SceneError: It is not YAML, has unknown, doubled or missing keys, or says what a scene cannot be: a
            doubled id, a parent in its child, times that collide or run backwards, a bad number or quaternion.
    """
    try:
        return _scene(Document(text, file).section())
    except DocumentError as error:
        raise SceneError(str(error.place), error.given, error.allowed) from error


def _scene(top: Section) -> Scene:
    version = top.get("sfglab_scene")
    if version is True or version != FORMAT:
        raise top.refusal("sfglab_scene", version, f"{FORMAT}, the version that is read here")
    values = _properties(top, SCENE_PROPERTIES)
    next_id = top.whole("next_id", low=1)
    objects = [thing for section in top.items("objects") for thing in _objects(section)]
    top.close()
    draft = Draft(Scene(**values))
    _insert_all(draft, objects)
    scene = draft.scene()
    if next_id < scene.next_id:
        raise top.refusal("next_id", next_id, f"a number above every id, from {scene.next_id}")
    return replace(scene, next_id=next_id)


Placed = tuple[str, SceneObject]  #: Where in the file, and what.


def _objects(section: Section) -> Iterator[Placed]:
    """Yield an object and, for a trajectory, its waypoints, each with where it stands."""
    kind = _kind(section)
    pose = Pose()
    if section.has("pose"):
        inner = section.section("pose")
        pose = _pose(inner)
        inner.close()
    thing = kind(
        id=section.whole("id", low=1),
        name=section.get("name"),
        parent=section.whole("parent", ROOT, low=ROOT),
        pose=pose,
        **_properties(section, kind.properties),
    )
    yield str(section.here), thing
    if kind is TrajectoryObject:
        yield from _waypoints(section, thing.id)
    section.close()


def _kind(section: Section) -> type[SceneObject]:
    word = section.get("kind")
    known = [name for name, kind in KINDS.items() if kind is not WaypointObject]
    if word not in known:
        raise section.refusal("kind", word, " or ".join(known) + suggestion(word, known))
    return KINDS[word]


def _waypoints(section: Section, parent: int) -> Iterator[Placed]:
    before_ns = -1
    for line in section.items("waypoints"):
        time_ns = _time_ns(line, before_ns)
        waypoint = WaypointObject(
            id=line.whole("id", low=1),
            name=line.get("name", ""),
            parent=parent,
            pose=_pose(line),
            time_ns=time_ns,
            **_properties(line, WaypointObject.properties),
        )
        line.close()
        yield str(line.here), waypoint
        before_ns = time_ns


def _time_ns(section: Section, before_ns: int) -> int:
    seconds = section.get("time_s")
    if (
        isinstance(seconds, bool)
        or not isinstance(seconds, int | float)
        or not 0 <= seconds <= _LATEST_S
    ):
        raise section.refusal("time_s", seconds, f"seconds from 0 to {_LATEST_S}")
    time_ns = round(seconds * NS_PER_S)
    if time_ns <= before_ns:
        allowed = f"a time above the previous waypoint's, {before_ns / NS_PER_S}"
        raise section.refusal("time_s", seconds, allowed)
    return time_ns


def _pose(section: Section) -> Pose:
    position = section.numbers("xyz_m", 3)
    quat = section.numbers("quat_xyzw", 4, (0.0, 0.0, 0.0, 1.0))
    try:
        return Pose.at(position, quat)
    except PoseError as error:  # the numbers are finite, so it is the quaternion's length
        raise section.refusal("quat_xyzw", list(quat), "a quaternion of length 1") from error


def _properties(section: Section, properties: Iterable[Property]) -> dict[str, Any]:
    return {
        prop.name: prop.typed(section.get(prop.name), str(section.place_of(prop.name)))
        for prop in properties
        if section.has(prop.name)
    }


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
