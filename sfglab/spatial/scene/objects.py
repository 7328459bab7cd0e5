"""Objects of a scene (paper A, section 4.5): groups, agents, obstacles, zones, trajectories and waypoints.

Each is a value with an id that no other object ever gets, a name, a parent, and a pose in the parent.
Inspector, commands and file format go by descriptions of properties, whose values may be given typed or plain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar

from sfglab.errors import InvalidValueError
from sfglab.fields import field_docs
from sfglab.spatial.poses import Pose
from sfglab.spatial.trajectory.clearance import Box, Cylinder, Shape, Sphere
from sfglab.spatial.trajectory.limits import Limits, Quantity
from sfglab.spatial.trajectory.path import LATEST_NS, Align, Interpolation

if TYPE_CHECKING:
    from collections.abc import Callable


class SceneError(InvalidValueError):
    """A scene, edit or file that is not allowed, by object and property or line and key; nothing changed."""


_LONGEST = 100
Schema = dict[str, Any]
_ABOVE_0, _FROM_0 = {"type": "number", "exclusiveMinimum": 0}, {"type": "number", "minimum": 0}
_SHAPES: dict[str, type[Shape]] = {"box": Box, "sphere": Sphere, "cylinder": Cylinder}


@dataclass(frozen=True, slots=True, kw_only=True)
class Property:
    """One property of a kind of object."""

    name: str  #: Its name, with unit.
    allowed: str  #: What it may be, in words.
    #: From a typed or plain value to the typed; raises ValueError or TypeError.
    parse: Callable[[Any], Any]
    schema: Schema  #: What stands in a file, as JSON Schema.
    #: From the typed value to what stands in a file.
    plain: Callable[[Any], Any] = lambda value: value
    #: What may be chosen, for a form; empty where anything else is asked for.
    choices: tuple[str, ...] = ()

    def typed(self, value: Any, place: str) -> Any:
        """Return a value as the property holds it; SceneError where it is not allowed."""
        try:
            return self.parse(value)
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise SceneError(place, value, self.allowed) from error

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Let pydantic read the property from a file."""
        from pydantic_core.core_schema import no_info_plain_validator_function

        return no_info_plain_validator_function(self._read)

    def _read(self, value: Any) -> Any:
        try:
            return self.parse(value)
        except (ValueError, TypeError, KeyError, OverflowError) as error:
            raise InvalidValueError((), value, self.allowed) from error

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return dict(self.schema)


def as_name(value: Any) -> str:
    """Return a name: 1 to 100 printable characters; ValueError where it is none."""
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST or not value.isprintable():
        raise ValueError(value)
    return value


def text(name: str) -> Property:
    """Return the property of a short text."""
    schema = {"type": "string", "minLength": 1, "maxLength": _LONGEST}
    return Property(
        name=name, allowed=f"1 to {_LONGEST} printable characters", parse=as_name, schema=schema
    )


_NAME = text("name")


def length(name: str, *, optional: bool = False, zero: bool = False) -> Property:
    """Return the property of a finite number above zero, or from it on; None, where optional, is no limit."""

    def parse(value: Any) -> float | None:
        if value is None and optional:
            return None
        number = _number(value)
        if number < 0.0 or (number == 0.0 and not zero):
            raise ValueError(value)
        return number

    allowed = (
        "a finite number "
        + ("from zero" if zero else "above zero")
        + (", or none" if optional else "")
    )
    schema = (_FROM_0 if zero else _ABOVE_0) | {
        "type": ["number", "null"] if optional else "number"
    }
    return Property(name=name, allowed=allowed, parse=parse, schema=schema)


def choice(name: str, kind: type[Enum]) -> Property:
    """Return the property of one of an enumeration's members, in files by its value."""
    words = tuple(str(member.value) for member in kind)
    return Property(
        name=name,
        allowed=" or ".join(words),
        parse=kind,
        plain=lambda value: value.value,
        choices=words,
        schema={"enum": list(words)},
    )


def reference(name: str, what: str) -> Property:
    """Return the property of another object's id, or of none."""

    def parse(value: Any) -> int | None:
        if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
            raise TypeError(value)
        return value

    schema = {"type": ["integer", "null"]}
    return Property(name=name, allowed=f"the id of {what}, or none", parse=parse, schema=schema)


def shape(name: str) -> Property:
    """Return the property of a body: box, sphere or cylinder."""
    forms = (
        f"{word} with {' and '.join(f.name for f in fields(of))}" for word, of in _SHAPES.items()
    )
    schema = {"oneOf": [_shape_schema(word, of) for word, of in _SHAPES.items()]}
    return Property(
        name=name, allowed=" or ".join(forms), parse=_to_shape, plain=_plain_shape, schema=schema
    )


def _shape_schema(word: str, of: type[Shape]) -> Schema:
    edges = {"type": "array", "items": _ABOVE_0, "minItems": 3, "maxItems": 3}
    sizes = {
        name: (edges if name == "size_m" else _ABOVE_0) | {"description": text}
        for name, text in field_docs(of).items()
    }
    return {
        "type": "object",
        "properties": {"kind": {"const": word}, **sizes},
        "required": ["kind", *sizes],
        "additionalProperties": False,
    }


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError(value)
    return float(value)


def _to_shape(value: Any) -> Shape:
    sizes = _plain_shape(value) if isinstance(value, Box | Sphere | Cylinder) else dict(value)
    made = _SHAPES[sizes.pop("kind")]
    if sizes.keys() != {f.name for f in fields(made)}:
        raise ValueError(value)
    numbers: Any = {
        key: _sizes(size) if key == "size_m" else _number(size) for key, size in sizes.items()
    }
    return made(**numbers)


def _sizes(value: Any) -> tuple[float, float, float]:
    x, y, z = map(_number, value)
    return (x, y, z)


def _plain_shape(value: Shape) -> dict[str, Any]:
    word = next(word for word, of in _SHAPES.items() if isinstance(value, of))
    return {"kind": word} | {f.name: getattr(value, f.name) for f in fields(value)}


ROOT = 0  #: The parent of what stands at the top; no object has this id.
_FARTHEST_M = 1e6


class ZoneRule(Enum):
    """What a zone is for."""

    FORBIDDEN = "forbidden"  #: No agent may touch it.
    INSIDE = "inside"  #: Every waypoint must lie in this zone or in another one of this rule.


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneObject:
    """What all objects have."""

    kind: ClassVar[str] = ""  #: Its word in files.
    properties: ClassVar[tuple[Property, ...]] = ()  #: What it has beyond this.

    id: int  #: A whole number from 1, never given to another object.
    name: str  #: For people; several objects may share one.
    parent: int = ROOT  #: Id of the group or trajectory that holds it, or `ROOT`.
    pose: Pose = field(default_factory=Pose)  #: Where it is in its parent.


@dataclass(frozen=True, slots=True, kw_only=True)
class Group(SceneObject):
    """Holds other objects and moves them together."""

    kind: ClassVar[str] = "group"


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentObject(SceneObject):
    """A robot. Its pose counts as long as no trajectory moves it."""

    kind: ClassVar[str] = "agent"
    properties: ClassVar[tuple[Property, ...]] = (
        length("radius_m"),
        length("speed_m_s", optional=True),
        length("acceleration_m_s2", optional=True),
        length("yaw_rate_rad_s", optional=True),
    )

    radius_m: float = 0.3  #: Of the sphere around its origin that nothing may enter.
    speed_m_s: float | None = None  #: Its highest speed; None for no limit, as for the next two.
    acceleration_m_s2: float | None = None  #: Its highest acceleration.
    yaw_rate_rad_s: float | None = None  #: Its highest yaw rate.

    @property
    def limits(self) -> Limits:
        """What its trajectory must keep to."""
        return Limits(**{quantity.value: getattr(self, quantity.value) for quantity in Quantity})


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleObject(SceneObject):
    """A body that stands still and that no agent may touch."""

    kind: ClassVar[str] = "obstacle"
    properties: ClassVar[tuple[Property, ...]] = (shape("shape"),)

    #: The body, centred at the pose.
    shape: Shape = field(default_factory=lambda: Sphere(radius_m=0.5))


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoneObject(SceneObject):
    """A part of space with a rule."""

    kind: ClassVar[str] = "zone"
    properties: ClassVar[tuple[Property, ...]] = (shape("shape"), choice("rule", ZoneRule))

    #: The part, centred at the pose.
    shape: Shape = field(default_factory=lambda: Sphere(radius_m=0.5))
    rule: ZoneRule = ZoneRule.FORBIDDEN  #: What it is for.


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryObject(SceneObject):
    """Holds waypoints, in order of time."""

    kind: ClassVar[str] = "trajectory"
    properties: ClassVar[tuple[Property, ...]] = (
        reference("agent", "an agent that drives no other trajectory"),
        choice("interpolation", Interpolation),
    )

    #: Id of the agent that drives it; an agent drives one trajectory at most. None: nobody does yet.
    agent: int | None = None
    #: How to go from one waypoint to the next.
    interpolation: Interpolation = Interpolation.POLYLINE


@dataclass(frozen=True, slots=True, kw_only=True)
class WaypointObject(SceneObject):
    """Where a trajectory is at a time. It has a name only where somebody gave it one."""

    kind: ClassVar[str] = "waypoint"
    properties: ClassVar[tuple[Property, ...]] = (choice("align", Align),)

    name: str = ""
    time_ns: int = 0  #: Since the scene's time 0; no two of a trajectory share one.
    #: What its x axis follows. Unless `Align.NONE`, its orientation is derived and setting one changes nothing.
    align: Align = Align.NONE


KINDS: dict[str, type[SceneObject]] = {
    kind.kind: kind
    for kind in (Group, AgentObject, ObstacleObject, ZoneObject, TrajectoryObject, WaypointObject)
}
"""Every kind of object by its word."""


def place_of(thing: SceneObject) -> str:
    """Return how errors name an object: kind, id and name."""
    return f"{thing.kind} {thing.id}" + (f" ({thing.name})" if thing.name else "")


def checked_object(thing: SceneObject) -> SceneObject:
    """Return an object whose properties are typed, after checking what it says of itself.

    Raises:
        SceneError: An id, a name, a coordinate, a time or a property is not allowed.
    """
    place = place_of(thing)
    if isinstance(thing.id, bool) or not isinstance(thing.id, int) or thing.id <= ROOT:
        raise SceneError(f"{thing.kind}, id", thing.id, "a whole number from 1")
    if thing.name != "" or not isinstance(thing, WaypointObject):
        _NAME.typed(thing.name, f"{thing.kind} {thing.id}, name")
    if not isinstance(thing.pose, Pose):
        raise SceneError(f"{place}, pose", thing.pose, "a pose")
    if not all(abs(c) <= _FARTHEST_M for c in thing.pose.position_m):
        raise SceneError(
            f"{place}, position", thing.pose.position_m, f"metres within {_FARTHEST_M:g} of 0"
        )
    if isinstance(thing, WaypointObject):
        given = thing.time_ns
        if isinstance(given, bool) or not isinstance(given, int) or not 0 <= given <= LATEST_NS:
            raise SceneError(
                f"{place_of(thing)}, time_ns", given, f"whole nanoseconds from 0 to {LATEST_NS}"
            )
    typed = {
        p.name: p.typed(getattr(thing, p.name), f"{place}, {p.name}") for p in thing.properties
    }
    return replace(thing, **typed)
