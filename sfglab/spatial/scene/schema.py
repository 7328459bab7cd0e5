"""JSON Schema of scene files, from the properties of their objects and the keys that stand around them.

Knows the form of a file that `files` reads and writes; refuses to know what objects may be to each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.fields import bounds, field_docs, to_json
from sfglab.schema import Schema, SchemaMaker
from sfglab.spatial.scene.files import FORMAT
from sfglab.spatial.scene.objects import (
    KINDS,
    ROOT,
    Property,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Scene
from sfglab.spatial.trajectory.path import LATEST_NS
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True, slots=True, kw_only=True)
class _PoseKeys:
    """A pose in the parent."""

    xyz_m: tuple[float, float, float]  #: Position along x, y and z.
    #: Orientation, of length 1.
    quat_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class _ObjectKeys:
    """An object of a scene."""

    id: int = field(metadata=bounds(1))  #: Never given to another object.
    name: str  #: For people; several objects may share one.
    parent: int = ROOT  #: Id of the object that holds it; 0: none.
    #: Where it is in its parent; the parent's own place where it is left out.
    pose: _PoseKeys | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _WaypointKeys(_PoseKeys):
    """Where a trajectory is at a time."""

    id: int = field(metadata=bounds(1))  #: Never given to another object.
    #: Above the previous waypoint's.
    time_s: float = field(metadata=bounds(0, LATEST_NS // NS_PER_S))
    name: str = ""  #: Only where somebody gave it one.


@dataclass(frozen=True, slots=True, kw_only=True)
class _SceneKeys:
    """A scene for `sfglab plan`: agents, obstacles, zones and trajectories in one tree."""

    sfglab_scene: int = field(metadata=bounds(FORMAT, FORMAT))  #: Version of the format.
    next_id: int = field(metadata=bounds(1))  #: A number above every id that was ever given.


def scene_schema() -> Schema:
    """Return the JSON Schema of scene files."""
    maker = SchemaMaker()
    top = maker.mapping(_SceneKeys)
    top["properties"] |= _described(Scene, SCENE_PROPERTIES)
    things = {
        "oneOf": [
            _kind_schema(maker, kind) for kind in KINDS.values() if kind is not WaypointObject
        ]
    }
    top["properties"]["objects"] = {
        "description": "What stands in it.",
        "type": "array",
        "items": things,
    }
    return maker.finished(top)


def _kind_schema(maker: SchemaMaker, kind: type[SceneObject]) -> Schema:
    schema = maker.mapping(_ObjectKeys)
    schema["description"] = kind.__doc__ or ""
    schema["properties"] = {"kind": {"const": kind.kind}} | schema["properties"]
    schema["properties"] |= _described(kind, kind.properties)
    schema["required"].append("kind")
    if kind is TrajectoryObject:
        waypoint = maker.reference(_WaypointKeys)
        maker.definition(_WaypointKeys)["properties"] |= _described(
            WaypointObject, WaypointObject.properties
        )
        about = "In order of time."
        schema["properties"]["waypoints"] = {
            "description": about,
            "type": "array",
            "items": waypoint,
        }
    return schema


def _described(kind: type[Any], properties: Iterable[Property]) -> dict[str, Schema]:
    docs, defaults = field_docs(kind), {f.name: f.default for f in fields(kind)}
    return {
        p.name: {"description": docs[p.name], "default": to_json(defaults[p.name])} | p.schema
        if isinstance(defaults[p.name], str | float | Enum)
        else {"description": docs[p.name]} | p.schema
        for p in properties
    }
