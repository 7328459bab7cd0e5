"""Objects of a scene (paper A, section 4.5): groups, agents, obstacles, zones, trajectories and waypoints.

Each object is a value with an id that no other object ever gets, a name, a parent, and a pose in its parent. Types
and bounds of the fields are declared only here: pydantic checks files and edits with them, and the
inspector derives its fields from them.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from sfglab.documents import OR_NULL, ReadAs
from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds, bounds, to_json
from sfglab.spatial.poses import Pose, PoseError, Quat
from sfglab.spatial.trajectory.path import LATEST_NS, Align, Interpolation
from sfglab.validation import Source, read

if TYPE_CHECKING:
    from collections.abc import Mapping

Floats = NDArray[np.float64]
T = TypeVar("T")
Thing = TypeVar("Thing", bound="SceneObject")

ROOT = 0  #: Parent of the objects at the top; no object has this id.
_LONGEST = 100
_FARTHEST_M = 1e6


class SceneError(InvalidValueError):
    """A scene, an edit or a file that is not allowed; nothing changed."""


def _printable(text: str) -> str:
    if len(text) > _LONGEST or not text.isprintable():
        raise InvalidValueError((), text, f"1 to {_LONGEST} printable characters")
    return text


def _orientation(quat_xyzw: Quat) -> Quat:
    try:
        Pose.at(quat_xyzw=quat_xyzw)
    except PoseError as error:
        raise InvalidValueError((), list(quat_xyzw), "a quaternion of length 1") from error
    return quat_xyzw


Text = Annotated[str, ReadAs(str, _printable)]
Length = Annotated[float, Bounds(0, without=(0,))]
Coordinate = Annotated[float, Bounds(-_FARTHEST_M, _FARTHEST_M)]


# --- Shapes -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A box, centred at its pose."""

    kind: Literal["box"] = "box"  #: Kind of the shape.
    size_m: tuple[Length, Length, Length]  #: Lengths along x, y and z, m.

    def distances_m(self, points_m: Floats) -> Floats:
        """Return the distances of points, shape (n, 3), to the surface, m, shape (n,); negative inside."""
        return _distances(np.abs(points_m) - np.array(self.size_m) / 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere:
    """A sphere, centred at its pose."""

    kind: Literal["sphere"] = "sphere"  #: Kind of the shape.
    radius_m: Length  #: Radius, m.

    def distances_m(self, points_m: Floats) -> Floats:
        """Return the distances of points, shape (n, 3), to the surface, m, shape (n,); negative inside."""
        return np.asarray(np.linalg.norm(points_m, axis=1) - self.radius_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder:
    """A cylinder along the z axis of its pose, centred there."""

    kind: Literal["cylinder"] = "cylinder"  #: Kind of the shape.
    radius_m: Length  #: Radius, m.
    height_m: Length  #: Height, m; half of it is below the centre.

    def distances_m(self, points_m: Floats) -> Floats:
        """Return the distances of points, shape (n, 3), to the surface, m, shape (n,); negative inside."""
        beside = np.hypot(points_m[:, 0], points_m[:, 1]) - self.radius_m
        above = np.abs(points_m[:, 2]) - self.height_m / 2.0
        return _distances(np.stack([beside, above], axis=1))


Shape = Box | Sphere | Cylinder
SHAPES = ("box", "sphere", "cylinder")
_SPHERE = Sphere(radius_m=0.5)


def _distances(beyond: Floats) -> Floats:
    """Return the distances to a product of intervals, given how far a point is beyond each interval."""
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))


class ByKind:
    """Annotation of a type: the field ``kind`` of a value selects one of several dataclasses."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic import Field

        return handler.generate_schema(Annotated[source, Field(discriminator="kind")])

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        shape = handler(core)
        for option in shape["oneOf"]:
            needed = handler.resolve_ref_schema(option)["required"]
            if "kind" not in needed:
                needed.append("kind")
        return shape


# --- Objects ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseKeys:
    """Keys of an object's pose in its parent: position and orientation."""

    xyz_m: tuple[Coordinate, Coordinate, Coordinate]  #: Position along x, y and z, m.
    #: Orientation, of length 1.
    quat_xyzw: Annotated[Quat, ReadAs(Quat, _orientation)] = (0.0, 0.0, 0.0, 1.0)

    @property
    def pose(self) -> Pose:
        """The position and orientation as a `Pose`."""
        return Pose.at(self.xyz_m, self.quat_xyzw)


class ZoneRule(Enum):
    """Rule of a zone."""

    FORBIDDEN = "forbidden"  #: No agent may touch it.
    INSIDE = "inside"  #: The centre of each agent must be in a zone of this rule.


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneObject:
    """An object of a scene."""

    kind: str = ""  #: Kind of the object.
    id: int = field(metadata=bounds(1))  #: Number that no other object ever gets.
    name: Text  #: Name for people; several objects may share one.
    parent: int = field(default=ROOT, metadata=bounds(ROOT))  #: Id of its holder; 0: none.
    #: Pose in its parent; by default that of the parent.
    pose: Annotated[Pose, ReadAs(PoseKeys, lambda keys: keys.pose)] = field(default_factory=Pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class Group(SceneObject):
    """A group of objects, which moves all of them together."""

    kind: Literal["group"] = "group"


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentObject(SceneObject):
    """A robot. Its pose counts as long as no trajectory moves it."""

    kind: Literal["agent"] = "agent"
    radius_m: Length = 0.3  #: Radius of the sphere around its origin, m.
    speed_m_s: Annotated[Length | None, OR_NULL] = None  #: Highest speed, m/s; None: no limit.
    #: Highest acceleration, m/s²; None: no limit.
    acceleration_m_s2: Annotated[Length | None, OR_NULL] = None
    #: Highest yaw rate, rad/s; None: no limit.
    yaw_rate_rad_s: Annotated[Length | None, OR_NULL] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleObject(SceneObject):
    """A fixed body that no agent may touch."""

    kind: Literal["obstacle"] = "obstacle"
    shape: Annotated[Shape, ByKind()] = _SPHERE  #: Body, centred at the pose.


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoneObject(SceneObject):
    """A region of space with a rule for agents."""

    kind: Literal["zone"] = "zone"
    shape: Annotated[Shape, ByKind()] = _SPHERE  #: Part, centred at the pose.
    rule: ZoneRule = ZoneRule.FORBIDDEN  #: Rule for agents.


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryObject(SceneObject):
    """A trajectory: waypoints in order of time, and the agent that follows them."""

    kind: Literal["trajectory"] = "trajectory"
    #: Id of the agent that follows it; an agent follows one trajectory at most.
    agent: Annotated[int | None, OR_NULL] = None
    interpolation: Interpolation = Interpolation.POLYLINE  #: Way from one waypoint to the next.


@dataclass(frozen=True, slots=True, kw_only=True)
class WaypointObject(SceneObject):
    """A pose of a trajectory at a time. It may have no name."""

    kind: Literal["waypoint"] = "waypoint"
    name: Text = ""
    #: Time since the scene's time 0, ns, which no other waypoint of the trajectory has.
    time_ns: int = field(default=0, metadata=bounds(0, LATEST_NS))
    #: Direction of its x axis; unless `Align.NONE`, the orientation is derived.
    align: Align = Align.NONE


KINDS: dict[str, type[SceneObject]] = {
    "group": Group,
    "agent": AgentObject,
    "obstacle": ObstacleObject,
    "zone": ZoneObject,
    "trajectory": TrajectoryObject,
    "waypoint": WaypointObject,
}
"""Classes of a scene's objects by their ``kind``."""
COMMON = tuple(f.name for f in fields(SceneObject))  #: Names of the fields that all objects have.


def place_of(thing: SceneObject) -> str:
    """Return the text that identifies an object in errors: kind, id and name."""
    return f"{thing.kind} {thing.id}" + (f" ({thing.name})" if thing.name else "")


def plain(value: Any) -> Any:
    """Return a field's value in the form that it has in a file."""
    if isinstance(value, Pose):
        return {"xyz_m": list(value.position_m), "quat_xyzw": list(value.quat_xyzw)}
    return to_json(value)


def settings_of(thing: Any) -> dict[str, Any]:
    """Return the fields of an object that differ from their defaults, in the form that they have in a file."""
    found = {}
    for one in fields(thing):
        value = getattr(thing, one.name)
        default = one.default
        if one.default_factory is not MISSING:
            default = one.default_factory()
        if value != default:
            found[one.name] = plain(value)
    return found


def read_object(cls: type[T], values: Mapping[str, Any], place: str) -> T:
    """Return an object, or the settings of a scene, from values of its fields.

    Args:
        cls: Class of the object.
        values: Values by field, as Python values or as in a file. An empty text means the default if that is empty.
        place: Text with which errors begin.

    Raises:
        SceneError: A field is unknown, or its value is not allowed.
    """
    own: Any = cls
    empty = {one.name for one in fields(own) if one.default == ""}
    found = {}
    for key, value in values.items():
        if value != "" or key not in empty:
            found[key] = plain(value)
    try:
        made: T = read(cls, found, f"{place}, ", Source.FILE)
    except InvalidValueError as error:
        raise SceneError(error.place, error.given, error.allowed) from error
    return made


def changed(thing: Thing, /, **values: Any) -> Thing:
    """Return an object with other values of some fields, as in `read_object`.

    Raises:
        SceneError: A field is unknown, or its value is not allowed.
    """
    return read_object(type(thing), {**settings_of(thing), **values}, place_of(thing))
