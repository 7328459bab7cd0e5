"""Scenes as YAML files: the reader refuses unknown keys and names the line; the writer replaces a file atomically.

A scene always has the same bytes, and a small edit causes a small difference: objects are in the order of the
tree, one key per line, a waypoint on one line, and defaults are left out. Numbers have the fewest digits from which
the same float is read.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from sfglab.documents import Document, DocumentError
from sfglab.errors import InvalidValueError, KeyPath
from sfglab.fields import bounds
from sfglab.files import read_text, write_files
from sfglab.spatial.scene.model import (
    AgentObject,
    ByKind,
    Group,
    ObstacleObject,
    PoseKeys,
    SceneError,
    SceneObject,
    Text,
    TrajectoryObject,
    WaypointObject,
    ZoneObject,
    plain,
    settings_of,
)
from sfglab.spatial.scene.tree import SETTINGS, Scene, SceneSettings, scene_of
from sfglab.spatial.trajectory.path import LATEST_NS, Align
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

FORMAT = 1  #: Version of the file format.
_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./()+-]*( [A-Za-z0-9_./()+-]+)*")
_NO_TEXT = frozenset({"y", "n", "yes", "no", "on", "off", "true", "false", "null"})


# --- Writing ----------------------------------------------------------------------------------


def scene_text(scene: Scene) -> str:
    """Return a scene as the text of a YAML file."""
    lines = [f"sfglab_scene: {FORMAT}"]
    lines += [f"{name}: {_value(getattr(scene, name))}" for name in SETTINGS]
    lines.append(f"next_id: {scene.next_id}")
    lines.append("objects:" if scene.objects else "objects: []")
    for thing in scene.walk():
        if not isinstance(thing, WaypointObject):
            lines += _object_lines(scene, thing)
    return "\n".join(lines) + "\n"


def _object_lines(scene: Scene, thing: SceneObject) -> Iterator[str]:
    first = {"id": thing.id, "kind": thing.kind}
    for key, value in (first | settings_of(thing)).items():
        yield f"{'- ' if key == 'id' else '  '}{key}: {_value(value)}"
    if scene.held_by(thing.id) and isinstance(thing, TrajectoryObject):
        yield "  waypoints:"
        for waypoint in scene.waypoints(thing.id):
            yield f"  - {_value(_waypoint_keys(waypoint))}"


def _waypoint_keys(waypoint: WaypointObject) -> dict[str, Any]:
    """Return the keys of a waypoint in a file; the name is last."""
    found = settings_of(waypoint)
    keys: dict[str, Any] = {"id": waypoint.id, "time_s": waypoint.time_ns / NS_PER_S}
    keys |= plain(waypoint.pose)
    return keys | {key: found[key] for key in ("align", "name") if key in found}


def _value(value: Any) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return str(value)


def _number(value: float) -> str:
    """Return the shortest text that YAML 1.1 reads as this float; YAML 1.1 requires a point before an exponent."""
    digits = repr(value + 0.0)  # no -0.0
    if "." not in digits and "e" in digits:
        return digits.replace("e", ".0e")
    return digits


def _text(value: str) -> str:
    if _PLAIN.fullmatch(value) and value.lower() not in _NO_TEXT:
        return value
    return json.dumps(value, ensure_ascii=False)


def save_scene(scene: Scene, path: Path) -> None:
    """Write a scene into a file; at any moment the file holds either the old scene or the new one.

    Raises:
        SceneError: The file cannot be written; its former content is still there.
    """
    try:
        write_files({path: scene_text(scene)})
    except InvalidValueError as error:
        raise SceneError(path.name, error.given, error.allowed) from error


# --- Reading ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class WaypointKeys(PoseKeys):
    """A pose of a trajectory at a time."""

    id: int = field(metadata=bounds(1))  #: Number that no other object ever gets.
    #: Time since the scene's time 0, s, which no other waypoint of the trajectory has.
    time_s: float = field(metadata=bounds(0, LATEST_NS // NS_PER_S))
    name: Text = ""  #: Name, if it has one.
    #: Direction of its x axis; unless none, the orientation is derived.
    align: Align = Align.NONE


@dataclass(frozen=True, slots=True, kw_only=True)
class _TrajectoryKeys(TrajectoryObject):
    """A trajectory, which holds its waypoints."""

    waypoints: tuple[WaypointKeys, ...] = ()  #: Waypoints, in any order.


AnyObject = Annotated[Group | AgentObject | ObstacleObject | ZoneObject | _TrajectoryKeys, ByKind()]


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneKeys(SceneSettings):
    """A scene for `sfglab plan`: agents, obstacles, zones and trajectories in one tree."""

    sfglab_scene: Literal[1]  #: Version of the format.
    #: Number from which new objects get their ids; raised above those in the file.
    next_id: int = field(default=1, metadata=bounds(1))
    objects: tuple[AnyObject, ...] = ()  #: Objects; those of one holder in their order.


def read_scene(text: str, *, file: str = "scene.yaml") -> Scene:
    """Return the scene of a YAML text, its waypoints in order of time and aligned.

    Args:
        text: The text.
        file: Name of its file, for messages.

    Raises:
        SceneError: The text is not YAML; it has unknown, duplicate or missing keys; or it breaks a rule of scenes:
            a duplicate id, a loop of parents, equal times, a number or quaternion that is not allowed.
    """
    try:
        document = Document(text, file)
        keys = document.read(SceneKeys)
    except DocumentError as error:
        raise SceneError(str(error.place), error.given, error.allowed) from error
    objects: list[SceneObject] = []
    places: dict[int, str] = {}
    for path, thing in _objects(keys.objects):
        place = str(document.place(path))
        if thing.id in places:
            allowed = f"an id of its own; {places[thing.id]} has this one"
            raise SceneError(place, f"id {thing.id}", allowed)
        places[thing.id] = place
        objects.append(thing)
    settings = {name: getattr(keys, name) for name in SETTINGS}
    return scene_of(Scene(**settings, next_id=keys.next_id), objects, places)


def _objects(keys: tuple[Any, ...]) -> Iterator[tuple[KeyPath, SceneObject]]:
    """Yield each object with its place; the waypoints of a trajectory come after it."""
    for index, thing in enumerate(keys):
        path = ("objects", index)
        if not isinstance(thing, _TrajectoryKeys):
            yield path, thing
            continue
        own = {f.name: getattr(thing, f.name) for f in fields(TrajectoryObject)}
        yield path, TrajectoryObject(**own)
        for number, waypoint in enumerate(thing.waypoints):
            made = WaypointObject(
                id=waypoint.id,
                name=waypoint.name,
                parent=thing.id,
                pose=waypoint.pose,
                time_ns=round(waypoint.time_s * NS_PER_S),
                align=waypoint.align,
            )
            yield (*path, "waypoints", number), made


def load_scene(path: Path | str) -> Scene:
    """Read a scene file, such as ``data/scenes/hall.yaml``.

    Raises:
        SceneError: The file cannot be read, or has a mistake; the error names the place.
    """
    path = Path(path)
    try:
        text = read_text(path)
    except InvalidValueError as error:
        raise SceneError(path.name, error.given, error.allowed) from error
    return read_scene(text, file=path.name)
