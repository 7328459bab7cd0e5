"""What can stand in a scene: groups, agents, obstacles, zones, trajectories and their waypoints.

Paper A, section 4.5, calls them scene objects. Each is a value with an id that no other object ever gets, a
name, a parent, and a pose in the parent. Refuses to know the other objects of its scene (`tree`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import ClassVar

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.errors import SceneError
from sfglab.spatial.scene.properties import Property, as_name, choice, length, reference, shape
from sfglab.spatial.trajectory import LATEST_NS, Align, Interpolation, Limits, Shape, Sphere

ROOT = 0
"""The parent of what stands at the top; no object has this id."""
_FARTHEST_M = 1e6


class ZoneRule(Enum):
    """What a zone is for.

    Attributes:
        FORBIDDEN: No agent may touch it.
        INSIDE: Every waypoint must lie in this zone or in another one of this rule.
    """

    FORBIDDEN = "forbidden"
    INSIDE = "inside"


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
        return Limits(
            speed_m_s=self.speed_m_s,
            acceleration_m_s2=self.acceleration_m_s2,
            yaw_rate_rad_s=self.yaw_rate_rad_s,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleObject(SceneObject):
    """A body that stands still and that no agent may touch."""

    kind: ClassVar[str] = "obstacle"
    properties: ClassVar[tuple[Property, ...]] = (shape("shape"),)

    shape: Shape = field(default_factory=lambda: Sphere(radius_m=0.5))  #: The body, centred at the pose.


@dataclass(frozen=True, slots=True, kw_only=True)
class ZoneObject(SceneObject):
    """A part of space with a rule."""

    kind: ClassVar[str] = "zone"
    properties: ClassVar[tuple[Property, ...]] = (shape("shape"), choice("rule", ZoneRule))

    shape: Shape = field(default_factory=lambda: Sphere(radius_m=0.5))  #: The part, centred at the pose.
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
    interpolation: Interpolation = Interpolation.POLYLINE  #: How to go from one waypoint to the next.


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
        try:
            as_name(thing.name)
        except ValueError as error:
            raise SceneError(
                f"{thing.kind} {thing.id}, name", thing.name, "1 to 100 printable characters"
            ) from error
    if not isinstance(thing.pose, Pose):
        raise SceneError(f"{place}, pose", thing.pose, "a pose")
    if not all(abs(c) <= _FARTHEST_M for c in thing.pose.position_m):
        raise SceneError(f"{place}, position", thing.pose.position_m, f"metres within {_FARTHEST_M:g} of 0")
    if isinstance(thing, WaypointObject):
        _check_time(thing)
    return replace(
        thing, **{p.name: p.typed(getattr(thing, p.name), f"{place}, {p.name}") for p in thing.properties}
    )


def _check_time(waypoint: WaypointObject) -> None:
    given = waypoint.time_ns
    if isinstance(given, bool) or not isinstance(given, int) or not 0 <= given <= LATEST_NS:
        raise SceneError(f"{place_of(waypoint)}, time_ns", given, f"whole nanoseconds from 0 to {LATEST_NS}")
