"""A scene as a value: objects, who holds whom, and what follows from it.

Every state of a scene is a value that shares what did not change with the one before. `Draft` is where a next
state is made: it checks whatever concerns more than one object.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.objects import (
    ROOT,
    AgentObject,
    Group,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    checked_object,
    length,
    place_of,
    text,
)
from sfglab.spatial.trajectory.path import Trajectory, Waypoint, aligned_quat, in_frame

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

#: A waypoint aligned as well as this is left alone, so that files read back byte by byte.
_SAME_RAD = 1e-9

#: Of a scene itself.
SCENE_PROPERTIES = (text("name"), text("frame_id"), length("margin_m", zero=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A tree of objects.

    Raises:
        SceneError: By every method that takes an id: there is no object of this id, or it is of another kind.
    """

    name: str = "scene"  #: For people.
    frame_id: str = "map"  #: The frame of what stands at the top, for messages.
    margin_m: float = 0.1  #: How far agents must stay apart beyond their radii.
    next_id: int = 1  #: The least id that no object of this scene ever had.
    objects: Mapping[int, SceneObject] = field(default_factory=dict)  #: Every object by id.
    #: Ids that `ROOT`, a group or a trajectory holds, in order; a trajectory's in order of time.
    children: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def get(self, id_: int) -> SceneObject:
        """Return an object."""
        return _found(self.objects, id_)

    def of_kind(self, id_: int, kind: type[Any]) -> Any:
        """Return an object of a kind."""
        found = self.get(id_)
        if not isinstance(found, kind):
            raise SceneError("object id", place_of(found), f"the id of a {kind.kind}")
        return found

    def held_by(self, id_: int = ROOT) -> tuple[int, ...]:
        """Return the ids that an object, or the top, holds."""
        return self.children.get(id_, ())

    def walk(self, id_: int = ROOT) -> Iterator[SceneObject]:
        """Yield what an object, or the top, holds: each before what it holds itself, in order."""
        pending = list(reversed(self.held_by(id_)))
        while pending:
            found = self.objects[pending.pop()]
            yield found
            pending.extend(reversed(self.held_by(found.id)))

    def all_of(self, kind: type[Any]) -> Iterator[Any]:
        """Yield every object of a kind, in the tree's order."""
        return (thing for thing in self.walk() if isinstance(thing, kind))

    def world_pose(self, id_: int) -> Pose:
        """Return where an object is in the scene's frame; `ROOT` is at its origin."""
        pose = Pose()
        while id_ != ROOT:
            thing = self.get(id_)
            pose, id_ = thing.pose @ pose, thing.parent
        return pose

    def trajectory(self, id_: int) -> Trajectory | None:
        """Return the waypoints of a trajectory in its own frame, None where there are none yet."""
        thing: TrajectoryObject = self.of_kind(id_, TrajectoryObject)
        found = tuple(
            Waypoint(time_ns=w.time_ns, pose=w.pose)
            for w in (self.objects[i] for i in self.held_by(id_))
            if isinstance(w, WaypointObject)
        )
        return Trajectory(waypoints=found, interpolation=thing.interpolation) if found else None

    def world_trajectory(self, id_: int) -> Trajectory | None:
        """Return a trajectory in the scene's frame, None where it has no waypoints yet."""
        found = self.trajectory(id_)
        return None if found is None else in_frame(found, self.world_pose(id_))

    def driven_by(self, agent: int) -> TrajectoryObject | None:
        """Return the trajectory that an agent drives, if any."""
        found = (
            t for t in self.objects.values() if isinstance(t, TrajectoryObject) and t.agent == agent
        )
        return next(found, None)

    def motion(self, agent: int) -> Trajectory:
        """Return how an agent moves in the scene's frame: its trajectory, or standing where its pose is."""
        self.of_kind(agent, AgentObject)
        driven = self.driven_by(agent)
        found = None if driven is None else self.world_trajectory(driven.id)
        return Trajectory.standing(self.world_pose(agent)) if found is None else found


class Draft:
    """A scene in the making; the scene it was made from stays as it is."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._objects = dict(scene.objects)
        self._children = dict(scene.children)
        self._next_id = scene.next_id
        self._unsettled: set[int] = set()

    def scene(self) -> Scene:
        """Return what was made, with aligned waypoints turned along their segments."""
        for trajectory in self._unsettled & self._objects.keys():
            self._settle(trajectory)
        self._unsettled.clear()
        children = {id_: held for id_, held in self._children.items() if held}
        return replace(self._scene, objects=self._objects, children=children, next_id=self._next_id)

    def get(self, id_: int) -> SceneObject:
        """Return an object as it is by now."""
        return _found(self._objects, id_)

    def insert(self, thing: SceneObject, index: int | None = None) -> None:
        """Put a new object under its parent, at an index among its siblings or the end; waypoints go by time.

        Raises:
            SceneError: The object, its id, its parent, its time or its agent is not allowed.
        """
        thing = checked_object(thing)
        if thing.id in self._objects:
            taken = place_of(self._objects[thing.id])
            raise SceneError(
                place_of(thing), f"id {thing.id}", f"an id of its own; {taken} has this one"
            )
        self._check_parent(thing, thing.parent)
        self._check_agent(thing)
        self._attach(thing, index)
        self._next_id = max(self._next_id, thing.id + 1)

    def remove(self, id_: int) -> None:
        """Take away an object with all it holds; a trajectory without its agent stays, without agent."""
        self._detach(self.get(id_))
        pending = [id_]
        while pending:
            gone = pending.pop()
            pending.extend(self._children.pop(gone, ()))
            if isinstance(self._objects.pop(gone), AgentObject):
                self._forget(gone)

    def put(self, thing: SceneObject) -> None:
        """Replace an object by one of its id and parent; SceneError if not allowed, or its time is taken."""
        thing = checked_object(thing)
        self._check_agent(thing)
        before = self.get(thing.id)
        if isinstance(thing, WaypointObject):
            self._detach(before)
            self._attach(thing, None)
            return
        self._objects[thing.id] = thing
        if isinstance(thing, TrajectoryObject):
            self._unsettled.add(thing.id)

    def put_times(self, trajectory: int, times_ns: list[int]) -> None:
        """Give all waypoints of a trajectory new times, which grow as the old ones did."""
        for id_, time_ns in zip(self._children.get(trajectory, ()), times_ns, strict=True):
            self._objects[id_] = checked_object(replace(self._waypoint(id_), time_ns=time_ns))

    def move(self, thing: SceneObject, parent: int, index: int | None) -> None:
        """Put an object, its pose that in the new parent, elsewhere; the index is without it, None the end.

        Raises:
            SceneError: The parent cannot hold it, lies inside it, or a waypoint's time is taken there.
        """
        self._check_parent(thing, parent)
        above = parent
        while above != ROOT:
            if above == thing.id:
                raise SceneError(
                    f"{place_of(thing)}, parent", parent, "a parent that does not lie inside it"
                )
            above = self._objects[above].parent
        self._detach(self.get(thing.id))
        self._attach(checked_object(replace(thing, parent=parent)), index)

    def _waypoint(self, id_: int) -> WaypointObject:
        found = self._objects[id_]
        assert isinstance(found, WaypointObject)  # a trajectory holds nothing else
        return found

    def _check_parent(self, thing: SceneObject, parent: int) -> None:
        place = f"{place_of(thing)}, parent"
        held_by = self._objects.get(parent)
        if isinstance(thing, WaypointObject):
            if not isinstance(held_by, TrajectoryObject):
                raise SceneError(place, parent, "the id of a trajectory")
        elif parent != ROOT and not isinstance(held_by, Group):
            raise SceneError(place, parent, f"the id of a group, or {ROOT} for the top")

    def _check_agent(self, thing: SceneObject) -> None:
        if not isinstance(thing, TrajectoryObject) or thing.agent is None:
            return
        place = f"{place_of(thing)}, agent"
        if not isinstance(self._objects.get(thing.agent), AgentObject):
            raise SceneError(place, thing.agent, "the id of an agent in the scene, or none")
        for other in self._objects.values():
            if (
                isinstance(other, TrajectoryObject)
                and other.agent == thing.agent
                and other.id != thing.id
            ):
                allowed = f"an agent that drives no other; this one drives {other.id}"
                raise SceneError(place, thing.agent, allowed)

    def _attach(self, thing: SceneObject, index: int | None) -> None:
        held = self._children.get(thing.parent, ())
        if isinstance(thing, WaypointObject):
            index = self._place_in_time(thing, held)
            self._unsettled.add(thing.parent)
        elif index is None:
            index = len(held)
        elif isinstance(index, bool) or not isinstance(index, int) or not 0 <= index <= len(held):
            raise SceneError(
                f"{place_of(thing)}, index", index, f"0 to {len(held)}, or none for the end"
            )
        self._children[thing.parent] = (*held[:index], thing.id, *held[index:])
        self._objects[thing.id] = thing

    def _place_in_time(self, waypoint: WaypointObject, held: tuple[int, ...]) -> int:
        index = bisect_left(held, waypoint.time_ns, key=lambda id_: self._waypoint(id_).time_ns)
        if index < len(held) and self._waypoint(held[index]).time_ns == waypoint.time_ns:
            taken = f"a time of its own; waypoint {held[index]} has this one"
            raise SceneError(f"{place_of(waypoint)}, time_ns", waypoint.time_ns, taken)
        return index

    def _detach(self, thing: SceneObject) -> None:
        self._children[thing.parent] = tuple(
            id_ for id_ in self._children[thing.parent] if id_ != thing.id
        )
        if isinstance(thing, WaypointObject):
            self._unsettled.add(thing.parent)

    def _forget(self, agent: int) -> None:
        for id_, thing in self._objects.items():
            if isinstance(thing, TrajectoryObject) and thing.agent == agent:
                self._objects[id_] = replace(thing, agent=None)

    def _settle(self, trajectory: int) -> None:
        """Turn aligned waypoints along their segments."""
        held = [self._waypoint(id_) for id_ in self._children.get(trajectory, ())]
        positions = [waypoint.pose.position_m for waypoint in held]
        for index, here in enumerate(held):
            quat = aligned_quat(positions, index, here.align)
            if quat is None:
                continue
            turned = Pose(position_m=here.pose.position_m, quat_xyzw=quat)
            if here.pose.angle_rad(turned) > _SAME_RAD:
                self._objects[here.id] = replace(here, pose=turned)


def _found(objects: Mapping[int, SceneObject], id_: int) -> SceneObject:
    if id_ not in objects:
        raise SceneError("object id", id_, "the id of an object in the scene")
    return objects[id_]
