"""Edits as values: from a scene to the next one, or an error and nothing changed.

Whoever keeps the scene before an edit can undo it (`history`). Refuses to know who edits and why.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.errors import SceneError
from sfglab.spatial.scene.objects import (
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    place_of,
)
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Draft, Scene
from sfglab.spatial.trajectory import Align


class Command(Protocol):
    """An edit."""

    @property
    def label(self) -> str:
        """What the edit does, for the undo button."""

    def apply(self, scene: Scene) -> Scene:
        """Return the scene after the edit.

        Raises:
            SceneError: It is not allowed.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class Add:
    """Put new objects into the scene."""

    objects: tuple[SceneObject, ...]  #: Parents before what they hold, ids from the scene's `next_id` on.
    index: int | None = None  #: Where the first one stands among its siblings; at the end where it is None.

    @property
    def label(self) -> str:
        """What the edit does."""
        return f"Add {self.objects[0].kind}" if self.objects else "Add nothing"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the objects in it."""
        draft = Draft(scene)
        for position, thing in enumerate(self.objects):
            if isinstance(thing.id, int) and thing.id < scene.next_id:
                raise SceneError(
                    place_of(thing), f"id {thing.id}", f"ids from {scene.next_id}, never used before"
                )
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
    #: Where among the siblings there, counted without it; at the end where it is None.
    index: int | None = None
    #: It stays where it is in the scene and gets another pose in its parent; else the reverse.
    keep_place: bool = True

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Move in the tree"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the object elsewhere in the tree."""
        thing = scene.get(self.id)
        if (
            self.keep_place
            and self.parent != thing.parent
            and (not self.parent or self.parent in scene.objects)
        ):
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

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Rename"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the object renamed."""
        return _with(scene, replace(scene.get(self.id), name=self.name))


@dataclass(frozen=True, slots=True, kw_only=True)
class SetPose:
    """Put an object elsewhere in its parent; an aligned waypoint keeps looking along its segment."""

    id: int  #: Which.
    pose: Pose  #: Where, in its parent.

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Change pose"

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
            raise SceneError(
                f"{place_of(thing)}, property", self.key, " or ".join(known) or "none has this kind"
            )
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
