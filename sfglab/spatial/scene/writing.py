"""Scenes as text: the same scene always gives the same bytes, and a small edit a small difference.

Objects stand in the tree's order, one key a line, a waypoint on one line; what has its default value is left
out. Numbers are the shortest that read back as the same float. Refuses to know files.
"""

from __future__ import annotations

import re
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.objects import ROOT, SceneObject, WaypointObject
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Scene

if TYPE_CHECKING:
    from collections.abc import Iterator


FORMAT = 1
"""The version of the file format."""
_NS_PER_S = 1_000_000_000
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
        yield f"  pose: {{{_pose(thing.pose)}}}"
    for key, value in _said(thing):
        yield f"  {key}: {_scalar(value)}"
    held = [w for w in (scene.objects[i] for i in scene.held_by(thing.id)) if isinstance(w, WaypointObject)]
    if held:
        yield "  waypoints:"
        yield from (f"  - {{{_waypoint(waypoint)}}}" for waypoint in held)


def _waypoint(waypoint: WaypointObject) -> str:
    sec, ns = divmod(waypoint.time_ns, _NS_PER_S)
    fraction = f"{ns:09d}".rstrip("0") or "0"
    parts = [f"id: {waypoint.id}", f"time_s: {sec}.{fraction}", _pose(waypoint.pose)]
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


def _pose(pose: Pose) -> str:
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
