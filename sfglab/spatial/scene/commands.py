"""Edits as values: from a scene to the next one, or an error and nothing changed; and the way back.

A step keeps the scene before and after it, which share what does not change: undoing is going back to a value.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.objects import (
    AgentObject,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    place_of,
)
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Draft, Scene
from sfglab.spatial.trajectory.limits import Limits, retimed
from sfglab.spatial.trajectory.path import Align, Trajectory, TrajectoryError, stretched

if TYPE_CHECKING:
    from collections.abc import Callable


class Command(Protocol):
    """An edit."""

    @property
    def label(self) -> str:
        """What the edit does, for the undo button."""

    def apply(self, scene: Scene) -> Scene:
        """Return the scene after the edit; SceneError where it is not allowed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Add:
    """Put new objects into the scene."""

    #: Parents before what they hold, ids from the scene's `next_id` on.
    objects: tuple[SceneObject, ...]
    #: Where the first one stands among its siblings; at the end where it is None.
    index: int | None = None

    @property
    def label(self) -> str:
        """What the edit does."""
        return f"Add {self.objects[0].kind}" if self.objects else "Add nothing"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the objects in it."""
        draft = Draft(scene)
        for position, thing in enumerate(self.objects):
            if isinstance(thing.id, int) and thing.id < scene.next_id:
                allowed = f"ids from {scene.next_id}, never used before"
                raise SceneError(place_of(thing), f"id {thing.id}", allowed)
            draft.insert(_undriven(thing), None if position else self.index)
        for thing in self.objects:
            if isinstance(thing, TrajectoryObject) and thing.agent is not None:
                draft.put(thing)
        return draft.scene()


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove:
    """Take objects out of the scene, with all they hold."""

    ids: tuple[int, ...]  #: Which; one that lies inside another one of them goes with it.

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Remove" if len(self.ids) == 1 else f"Remove {len(self.ids)} objects"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene without the objects."""
        draft = Draft(scene)
        gone: set[int] = set()
        for id_ in self.ids:
            inside = {thing.id for thing in scene.walk(scene.get(id_).id)}
            if id_ not in gone:
                draft.remove(id_)
            gone |= {id_} | inside
        return draft.scene()


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """Put an object under another parent, or elsewhere among its siblings."""

    id: int  #: Which.
    parent: int  #: The new parent's id, or `ROOT`.
    #: Where among the siblings there, counted without it; None: at the end.
    index: int | None = None
    #: It stays where it is in the scene; else it keeps its pose in its parent.
    keep_place: bool = True

    label: ClassVar[str] = "Move in the tree"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the object elsewhere in the tree."""
        thing = scene.get(self.id)
        is_held = not self.parent or self.parent in scene.objects
        if self.keep_place and is_held and self.parent != thing.parent:
            pose = scene.world_pose(self.parent).inverse() @ scene.world_pose(self.id)
            thing = replace(thing, pose=pose)
        draft = Draft(scene)
        draft.move(thing, self.parent, self.index)
        return draft.scene()


@dataclass(frozen=True, slots=True, kw_only=True)
class Rename:
    """Give an object another name."""

    id: int  #: Which.
    name: str  #: 1 to 100 printable characters; for a waypoint also none.

    label: ClassVar[str] = "Rename"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the object renamed."""
        return _with(scene, replace(scene.get(self.id), name=self.name))


@dataclass(frozen=True, slots=True, kw_only=True)
class SetPose:
    """Put an object elsewhere in its parent; an aligned waypoint keeps looking along its segment."""

    id: int  #: Which.
    pose: Pose  #: Where, in its parent.

    label: ClassVar[str] = "Change pose"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the object elsewhere."""
        thing = scene.get(self.id)
        if not isinstance(self.pose, Pose):
            raise SceneError(f"{place_of(thing)}, pose", self.pose, "a pose")
        pose = self.pose
        if isinstance(thing, WaypointObject) and thing.align is not Align.NONE:
            pose = Pose(position_m=pose.position_m, quat_xyzw=thing.pose.quat_xyzw)
        return _with(scene, replace(thing, pose=pose))


@dataclass(frozen=True, slots=True, kw_only=True)
class SetProperty:
    """Change what an object is: a radius, a shape, an interpolation, an alignment."""

    id: int  #: Which object.
    key: str  #: The property's name.
    value: Any  #: Typed, or plain as in a file.

    @property
    def label(self) -> str:
        """What the edit does."""
        return f"Change {self.key}"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the property changed."""
        thing = scene.get(self.id)
        known = {prop.name: prop for prop in thing.properties}
        if self.key not in known:
            allowed = " or ".join(known) or "none has this kind"
            raise SceneError(f"{place_of(thing)}, property", self.key, allowed)
        value = known[self.key].typed(self.value, f"{place_of(thing)}, {self.key}")
        return _with(scene, replace(thing, **{self.key: value}))


@dataclass(frozen=True, slots=True, kw_only=True)
class SetScene:
    """Change what the scene says of itself."""

    key: str  #: ``name``, ``frame_id`` or ``margin_m``.
    value: Any  #: Its new value.

    @property
    def label(self) -> str:
        """What the edit does."""
        return f"Change {self.key}"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with its property changed."""
        known = {prop.name: prop for prop in SCENE_PROPERTIES}
        if self.key not in known:
            raise SceneError("scene, property", self.key, " or ".join(known))
        return replace(scene, **{self.key: known[self.key].typed(self.value, f"scene, {self.key}")})


@dataclass(frozen=True, slots=True, kw_only=True)
class Several:
    """Edits one after another, as one; all of them or none."""

    commands: tuple[Command, ...]  #: What to do, in order.
    label: str  #: What they do together.

    def apply(self, scene: Scene) -> Scene:
        """Return the scene after all of them."""
        for command in self.commands:
            scene = command.apply(scene)
        return scene


def _undriven(thing: SceneObject) -> SceneObject:
    """Return a trajectory without its agent, which may come after it; anything else as it is."""
    return replace(thing, agent=None) if isinstance(thing, TrajectoryObject) else thing


def _with(scene: Scene, thing: SceneObject) -> Scene:
    draft = Draft(scene)
    draft.put(thing)
    return draft.scene()


@dataclass(frozen=True, slots=True, kw_only=True)
class SetTime:
    """Give a waypoint another time; where that is beyond a neighbour's, their order changes."""

    id: int  #: Which waypoint.
    time_ns: int  #: Its time, which no other waypoint of the trajectory has.

    label: ClassVar[str] = "Change time"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the waypoint at its new time."""
        return _with(scene, replace(scene.of_kind(self.id, WaypointObject), time_ns=self.time_ns))


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignWaypoints:
    """Let all waypoints of a trajectory look along a neighbouring segment, or none. Paper A, section 4.5."""

    id: int  #: The trajectory.
    align: Align  #: Along which segment.

    label: ClassVar[str] = "Align waypoints"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with every waypoint aligned."""
        thing = scene.of_kind(self.id, TrajectoryObject)
        if not isinstance(self.align, Align):
            raise SceneError(
                f"{place_of(thing)}, align", self.align, " or ".join(a.value for a in Align)
            )
        draft = Draft(scene)
        for id_ in scene.held_by(self.id):
            waypoint = scene.of_kind(id_, WaypointObject)
            draft.put(replace(waypoint, align=self.align))
        return draft.scene()


@dataclass(frozen=True, slots=True, kw_only=True)
class Retime:
    """Slow a trajectory down along its path until limits hold."""

    id: int  #: The trajectory.
    limits: Limits | None = None  #: What must hold; its agent's where it is None.

    label: ClassVar[str] = "Keep to limits"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the trajectory slowed down."""
        thing = scene.of_kind(self.id, TrajectoryObject)
        limits = self.limits
        if limits is None:
            if thing.agent is None:
                raise SceneError(
                    f"{place_of(thing)}, limits", None, "limits, or an agent that drives it"
                )
            limits = scene.of_kind(thing.agent, AgentObject).limits
        return _retimed(scene, thing, partial(retimed, limits=limits))


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Let a trajectory take longer, or less long, from its first waypoint's time on."""

    id: int  #: The trajectory.
    factor: float  #: By how much every duration grows.

    label: ClassVar[str] = "Stretch in time"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the trajectory stretched."""
        thing = scene.of_kind(self.id, TrajectoryObject)
        return _retimed(scene, thing, partial(stretched, factor=self.factor))


def _retimed(
    scene: Scene, thing: TrajectoryObject, change: Callable[[Trajectory], Trajectory]
) -> Scene:
    trajectory = scene.trajectory(thing.id)
    if trajectory is None:
        raise SceneError(place_of(thing), "no waypoints", "a trajectory with waypoints")
    try:
        times_ns = [w.time_ns for w in change(trajectory).waypoints]
    except TrajectoryError as error:
        raise SceneError(
            f"{place_of(thing)}, times", str(error), "times that a trajectory may have"
        ) from error
    draft = Draft(scene)
    draft.put_times(thing.id, times_ns)
    return draft.scene()


_DEPTH = 1000


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """An edit that was done."""

    label: str  #: What it did.
    before: Scene  #: The scene before it.
    after: Scene  #: The scene after it.
    drag: str | None = None  #: The drag that it belongs to; None for an edit of its own.


class History:
    """A scene and the way it came about, of which the last `depth` steps can be undone."""

    def __init__(self, scene: Scene, *, depth: int = _DEPTH) -> None:
        self.scene = scene  #: As it is now.
        self._done: deque[Step] = deque(maxlen=depth)
        self._undone: list[Step] = []
        self._dropped: list[Step] = []
        #: An id that no object ever had, also none whose addition was undone.
        self.next_id = scene.next_id

    @property
    def undo_label(self) -> str | None:
        """What undo would take back, None where there is nothing."""
        return self._done[-1].label if self._done else None

    @property
    def redo_label(self) -> str | None:
        """What redo would do again, None where there is nothing."""
        return self._undone[-1].label if self._undone else None

    def do(self, command: Command, *, drag: str | None = None) -> bool:
        """Do an edit and return whether anything changed; edits of one drag, a new name each, become one step.

        What was undone can then no longer be redone, unless a drag ends where it began.

        Raises:
            SceneError: It is not allowed; nothing changed.
        """
        before, after = self.scene, command.apply(self.scene)
        if after == before:
            return False
        label = command.label
        if drag is not None and self._done and self._done[-1].drag == drag:
            first = self._done.pop()
            before, label = first.before, first.label
        else:
            self._dropped = self._undone
        if after == before:  # a drag came back to where it began, as if it had never been
            after, self._undone = before, self._dropped
        else:
            self._done.append(Step(label=label, before=before, after=after, drag=drag))
            self._undone = []
        self.scene = after
        self.next_id = max(self.next_id, after.next_id)
        return True

    def undo(self) -> Step | None:
        """Take the last step back; return it, or None where there is nothing."""
        if not self._done:
            return None
        step = self._done.pop()
        self._undone.append(replace(step, drag=None))  # what is done again belongs to no drag
        self.scene = step.before
        return step

    def redo(self) -> Step | None:
        """Do the last undone step again; return it, or None where there is nothing."""
        if not self._undone:
            return None
        step = self._undone.pop()
        self._done.append(step)
        self.scene = step.after
        return step
