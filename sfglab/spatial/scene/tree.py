"""A scene as a value: objects, their holders, and the rules that concern more than one object.

Each state of a scene is a value. `scene_of` makes the next state from its objects and checks it, so that files and
edits have the same rules.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from itertools import chain, pairwise
from types import MappingProxyType
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
Problem = tuple[SceneObject, str, object, str]  # object, its field, given, allowed

#: Angle up to which an aligned waypoint keeps its orientation, so that files read back byte by byte.
_SAME_RAD = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneSettings:
    """Properties of a scene that belong to none of its objects."""

    name: Text = "scene"  #: Name for people.
    frame_id: Text = "map"  #: Frame of the objects at the top, for messages.
    margin_m: Annotated[float, Bounds(0)] = 0.1  #: Least distance of agents beyond their radii, m.


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene(SceneSettings):
    """A tree of objects; `scene_of` makes a checked one.

    Raises:
        SceneError: A method was given an id that no object has, or that of an object of another kind.
    """

    next_id: int = 1  #: Lowest id that no object ever had.
    objects: Mapping[int, SceneObject] = field(default_factory=dict)  #: Objects by id.
    #: Ids that `ROOT`, a group or a trajectory holds, in order; waypoints in order of time.
    children: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def get(self, id_: int) -> SceneObject:
        """Return the object with an id, of any kind."""
        if id_ not in self.objects:
            raise SceneError("object id", id_, "the id of an object in the scene")
        return self.objects[id_]

    def of_kind(self, id_: int, kind: type[T]) -> T:
        """Return the object with an id, which must be of a class."""
        found = self.get(id_)
        if not isinstance(found, kind):
            words = [word for word, known in KINDS.items() if issubclass(known, kind)]
            raise SceneError("object id", place_of(found), f"the id of a {' or '.join(words)}")
        return found

    def held_by(self, id_: int = ROOT) -> tuple[int, ...]:
        """Return the ids of the objects that an object, or the top of the tree, holds."""
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
        """Return the trajectory that an agent follows; None if it follows none."""
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
    before: Scene, objects: Iterable[SceneObject], places: Mapping[int, str] = MappingProxyType({})
) -> Scene:
    """Return a scene with other objects, after a check of the rules that concern several objects.

    A trajectory holds each waypoint; the top of the tree or a group holds every other object; no object holds itself.
    The waypoints of a trajectory have different times. An agent follows at most one trajectory. The function turns
    aligned waypoints along their segments.

    Args:
        before: Scene whose own properties stay.
        objects: Checked objects with different ids; those of one holder in their order.
        places: Places of objects in a file, by id, for messages.

    Raises:
        SceneError: A rule does not hold.
    """
    found = {thing.id: thing for thing in objects}
    held: dict[int, list[SceneObject]] = {}
    for thing in sorted(found.values(), key=lambda thing: getattr(thing, "time_ns", 0)):
        held.setdefault(thing.parent, []).append(thing)
    problems = chain(_wrong_parents(found), _wrong_agents(found), _equal_times(held))
    for thing, key, given, allowed in problems:
        place = f"{place_of(thing)}, {key}"
        if thing.id in places:
            place = f"{places[thing.id]}: {place}"
        raise SceneError(place, given, allowed)
    for things in held.values():
        found |= {waypoint.id: waypoint for waypoint in _aligned(things)}
    next_id = max([before.next_id, *(id_ + 1 for id_ in found)])
    children = {id_: tuple(thing.id for thing in things) for id_, things in held.items()}
    return replace(before, next_id=next_id, objects=found, children=children)


def _wrong_parents(objects: Mapping[int, SceneObject]) -> Iterator[Problem]:
    """Find objects with a wrong parent, or in a loop of parents."""
    for thing in objects.values():
        holder = objects.get(thing.parent)
        if isinstance(thing, WaypointObject):
            if not isinstance(holder, TrajectoryObject):
                yield thing, "parent", thing.parent, "the id of a trajectory"
        elif thing.parent != ROOT and not isinstance(holder, Group):
            yield thing, "parent", thing.parent, f"the id of a group, or {ROOT} for the top"
        above = [thing.id]
        while holder is not None and holder.id not in above:
            above.append(holder.id)
            holder = objects.get(holder.parent)
        if holder is thing:
            loop = " in ".join(map(str, [*above, thing.id]))
            yield thing, "parent", f"a loop, {loop}", "a tree"


def _wrong_agents(objects: Mapping[int, SceneObject]) -> Iterator[Problem]:
    """Find trajectories whose agent does not exist, or follows another trajectory."""
    followed: dict[int, int] = {}
    for thing in objects.values():
        if not isinstance(thing, TrajectoryObject) or thing.agent is None:
            continue
        if not isinstance(objects.get(thing.agent), AgentObject):
            yield thing, "agent", thing.agent, "the id of an agent in the scene, or none"
        other = followed.setdefault(thing.agent, thing.id)
        if other != thing.id:
            allowed = f"an agent that follows no other trajectory; this one follows {other}"
            yield thing, "agent", thing.agent, allowed


def _equal_times(held: Mapping[int, list[SceneObject]]) -> Iterator[Problem]:
    """Find waypoints of a trajectory that have the same time."""
    for things in held.values():
        for one, after in pairwise(_waypoints(things)):
            if one.time_ns == after.time_ns:
                allowed = f"a time of its own; waypoint {one.id} has this one"
                yield after, "time_ns", after.time_ns, allowed


def _waypoints(things: Iterable[SceneObject]) -> list[WaypointObject]:
    return [thing for thing in things if isinstance(thing, WaypointObject)]


def _aligned(things: Iterable[SceneObject]) -> Iterator[WaypointObject]:
    """Yield the aligned waypoints whose orientation must change, turned along their segments."""
    waypoints = _waypoints(things)
    positions = [waypoint.pose.position_m for waypoint in waypoints]
    for index, waypoint in enumerate(waypoints):
        quat = aligned_quat(positions, index, waypoint.align)
        if quat is None:
            continue
        turned = Pose(position_m=waypoint.pose.position_m, quat_xyzw=quat)
        if waypoint.pose.angle_rad(turned) > _SAME_RAD:
            yield replace(waypoint, pose=turned)
