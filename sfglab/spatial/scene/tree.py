"""A scene as a value: objects, their holders, and the rules that concern more than one object.

Each state of a scene is a value. `scene_of` makes the next one from its objects and checks it: files and
edits have the same rules.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, TypeVar

from sfglab.fields import Bounds
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.model import (
    KINDS,
    ROOT,
    AgentObject,
    Group,
    SceneError,
    SceneObject,
    Text,
    TrajectoryObject,
    WaypointObject,
    place_of,
)
from sfglab.spatial.trajectory.path import Trajectory, Waypoint, aligned_quat, in_frame

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

T = TypeVar("T", bound=SceneObject)

#: Angle up to which an aligned waypoint keeps its orientation, so that files read back byte by byte.
_SAME_RAD = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSettings:
    """The properties of a scene itself."""

    name: Text = "scene"  #: Name for people.
    frame_id: Text = "map"  #: Frame of the objects at the top, for messages.
    margin_m: Annotated[float, Bounds(0)] = 0.1  #: Least distance of agents beyond their radii, m.


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene(SceneSettings):
    """A tree of objects; `scene_of` makes a checked one.

    Raises:
        SceneError: By each method that takes an id: no object has it, or the object is of another kind.
    """

    next_id: int = 1  #: Lowest id that no object ever had.
    objects: Mapping[int, SceneObject] = field(default_factory=dict)  #: Objects by id.
    #: Ids that `ROOT`, a group or a trajectory holds, in order; waypoints in order of time.
    children: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def get(self, id_: int) -> SceneObject:
        """Return an object."""
        if id_ not in self.objects:
            raise SceneError("object id", id_, "the id of an object in the scene")
        return self.objects[id_]

    def of_kind(self, id_: int, kind: type[T]) -> T:
        """Return an object of a class."""
        found = self.get(id_)
        if not isinstance(found, kind):
            words = [word for word, known in KINDS.items() if issubclass(known, kind)]
            raise SceneError("object id", place_of(found), f"the id of a {' or '.join(words)}")
        return found

    def held_by(self, id_: int = ROOT) -> tuple[int, ...]:
        """Return the ids that an object, or the top, holds."""
        return self.children.get(id_, ())

    def walk(self, id_: int = ROOT) -> Iterator[SceneObject]:
        """Yield all objects below an object, or below the top; each before those that it holds."""
        pending = list(reversed(self.held_by(id_)))
        while pending:
            found = self.objects[pending.pop()]
            yield found
            pending.extend(reversed(self.held_by(found.id)))

    def all_of(self, kind: type[T]) -> Iterator[T]:
        """Yield all objects of a class, in the order of the tree."""
        return (thing for thing in self.walk() if isinstance(thing, kind))

    def world_pose(self, id_: int) -> Pose:
        """Return the pose of an object in the scene's frame; `ROOT` is at its origin."""
        pose = Pose()
        while id_ != ROOT:
            thing = self.get(id_)
            pose, id_ = thing.pose @ pose, thing.parent
        return pose

    def waypoints(self, trajectory: int) -> list[WaypointObject]:
        """Return the waypoints of a trajectory, in order of time."""
        return [self.of_kind(id_, WaypointObject) for id_ in self.held_by(trajectory)]

    def trajectory(self, id_: int) -> Trajectory | None:
        """Return a trajectory in its own frame; None if it has no waypoint."""
        thing = self.of_kind(id_, TrajectoryObject)
        points = tuple(Waypoint(time_ns=w.time_ns, pose=w.pose) for w in self.waypoints(id_))
        if not points:
            return None
        return Trajectory(waypoints=points, interpolation=thing.interpolation)

    def world_trajectory(self, id_: int) -> Trajectory | None:
        """Return a trajectory in the scene's frame; None if it has no waypoint."""
        found = self.trajectory(id_)
        return None if found is None else in_frame(found, self.world_pose(id_))

    def driven_by(self, agent: int) -> TrajectoryObject | None:
        """Return the trajectory that an agent follows, if any."""
        for thing in self.objects.values():
            if isinstance(thing, TrajectoryObject) and thing.agent == agent:
                return thing
        return None

    def motion(self, agent: int) -> Trajectory:
        """Return the motion of an agent in the scene's frame: its trajectory, or standing at its pose."""
        self.of_kind(agent, AgentObject)
        driven = self.driven_by(agent)
        found = None if driven is None else self.world_trajectory(driven.id)
        return Trajectory.standing(self.world_pose(agent)) if found is None else found


SETTINGS = tuple(f.name for f in fields(SceneSettings))  #: Names of a scene's own properties.


def scene_of(
    before: Scene, objects: Iterable[SceneObject], places: Mapping[int, str] | None = None
) -> Scene:
    """Return a scene with other objects, after checking the rules between them.

    The top or a group holds each object, and a trajectory holds a waypoint; nothing holds itself. The waypoints
    of a trajectory have different times. An agent follows one trajectory at most. Aligned waypoints are
    turned along their segments.

    Args:
        before: Scene whose own properties stay.
        objects: Checked objects with different ids; those of one holder in their order.
        places: Places of objects in a file, by id, for messages.

    Raises:
        SceneError: A rule does not hold.
    """
    found = {thing.id: thing for thing in objects}
    rules = _Rules(found, places or {})
    held: dict[int, list[int]] = {}
    for thing in found.values():
        rules.check_parent(thing)
        held.setdefault(thing.parent, []).append(thing.id)
    rules.check_agents()
    changed = _changed_holders(before.objects, found)
    children: dict[int, tuple[int, ...]] = {}
    for id_, ids in held.items():
        children[id_] = tuple(ids) if id_ in changed else before.children[id_]
        if id_ in changed and isinstance(found.get(id_), TrajectoryObject):
            waypoints = rules.in_order_of_time(ids)
            children[id_] = tuple(waypoint.id for waypoint in waypoints)
            found |= {waypoint.id: waypoint for waypoint in _aligned(waypoints)}
    next_id = max([before.next_id, *(id_ + 1 for id_ in found)])
    return replace(before, next_id=next_id, objects=found, children=children)


def _changed_holders(
    before: Mapping[int, SceneObject], after: Mapping[int, SceneObject]
) -> set[int]:
    """Return the ids of those holders whose objects are not all as before."""
    gone = [thing for id_, thing in before.items() if after.get(id_) is not thing]
    come = [thing for id_, thing in after.items() if before.get(id_) is not thing]
    return {thing.parent for thing in (*gone, *come)}


class _Rules:
    """Rules between the objects of a scene."""

    def __init__(self, objects: Mapping[int, SceneObject], places: Mapping[int, str]) -> None:
        self._objects = objects
        self._places = places

    def check_parent(self, thing: SceneObject) -> None:
        """Check the holder of an object."""
        holder = self._objects.get(thing.parent)
        if isinstance(thing, WaypointObject):
            if not isinstance(holder, TrajectoryObject):
                raise self._refusal(thing, "parent", thing.parent, "the id of a trajectory")
            return
        if thing.parent != ROOT and not isinstance(holder, Group):
            allowed = f"the id of a group, or {ROOT} for the top"
            raise self._refusal(thing, "parent", thing.parent, allowed)
        above = [thing.id]
        while holder is not None and holder.id not in above[1:]:
            above.append(holder.id)
            if holder.id == thing.id:
                loop = " in ".join(map(str, above))
                raise self._refusal(thing, "parent", f"a loop, {loop}", "a tree")
            holder = self._objects.get(holder.parent)

    def check_agents(self) -> None:
        """Check the agents of trajectories."""
        followed: dict[int, int] = {}
        for thing in self._objects.values():
            if not isinstance(thing, TrajectoryObject) or thing.agent is None:
                continue
            if not isinstance(self._objects.get(thing.agent), AgentObject):
                allowed = "the id of an agent in the scene, or none"
                raise self._refusal(thing, "agent", thing.agent, allowed)
            other = followed.setdefault(thing.agent, thing.id)
            if other != thing.id:
                allowed = f"an agent that follows no other trajectory; this one follows {other}"
                raise self._refusal(thing, "agent", thing.agent, allowed)

    def in_order_of_time(self, ids: Iterable[int]) -> list[WaypointObject]:
        """Return the waypoints of a trajectory in order of time."""
        held = [self._objects[id_] for id_ in ids]
        waypoints = [thing for thing in held if isinstance(thing, WaypointObject)]
        waypoints.sort(key=lambda waypoint: waypoint.time_ns)
        for before, after in pairwise(waypoints):
            if before.time_ns == after.time_ns:
                allowed = f"a time of its own; waypoint {before.id} has this one"
                raise self._refusal(after, "time_ns", after.time_ns, allowed)
        return waypoints

    def _refusal(self, thing: SceneObject, key: str, given: object, allowed: str) -> SceneError:
        place = f"{place_of(thing)}, {key}"
        if thing.id in self._places:
            place = f"{self._places[thing.id]}: {place}"
        return SceneError(place, given, allowed)


def _aligned(waypoints: list[WaypointObject]) -> Iterator[WaypointObject]:
    """Yield those aligned waypoints that must be turned, turned along their segments."""
    positions = [waypoint.pose.position_m for waypoint in waypoints]
    for index, waypoint in enumerate(waypoints):
        quat = aligned_quat(positions, index, waypoint.align)
        if quat is None:
            continue
        turned = Pose(position_m=waypoint.pose.position_m, quat_xyzw=quat)
        if waypoint.pose.angle_rad(turned) > _SAME_RAD:
            yield replace(waypoint, pose=turned)
