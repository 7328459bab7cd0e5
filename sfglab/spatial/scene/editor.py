"""Editor without a user interface: a scene with its history, selection, time and file, and listeners for changes.

A browser, a notebook or a test calls the methods in one thread, and listens to changes; all decisions are here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.conflicts import Conflict, Ghost, conflicts, ghosts
from sfglab.spatial.scene.files import load_scene, save_scene
from sfglab.spatial.scene.model import (
    KINDS,
    ROOT,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    changed,
    place_of,
    read_object,
)
from sfglab.spatial.scene.tree import SETTINGS, Scene, SceneSettings, scene_of
from sfglab.spatial.trajectory.motion import pose_at
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from sfglab.spatial.trajectory.path import Align, Trajectory


_DEPTH = 1000  # steps that can be undone


class Change(Enum):
    """Kind of a change of the editor's state, which every listener receives."""

    EDIT = "edit"  #: An edit was made.
    UNDO = "undo"  #: A step was undone.
    REDO = "redo"  #: A step was redone.
    LOAD = "load"  #: Another scene was loaded.
    SAVE = "save"  #: The scene was saved.
    SELECTION = "selection"  #: Other objects are selected.
    TIME = "time"  #: The time slider moved.

    @property
    def is_of_scene(self) -> bool:
        """Whether the scene has changed, and not only the selection, the time or the file."""
        return self not in {Change.SAVE, Change.SELECTION, Change.TIME}


@dataclass(frozen=True, slots=True)
class _History:
    """Scenes, each with the label of the step that led to it, and the place of the current one."""

    scenes: tuple[Scene, ...]
    labels: tuple[str, ...] = ("",)
    at: int = 0

    def label(self, at: int) -> str | None:
        """Return the label of the step that led to a scene; None if no step did."""
        return self.labels[at] if 0 < at < len(self.labels) else None

    def then(self, label: str, scene: Scene) -> _History:
        """Return the history after a step to a scene; the same one if the scene is the current one."""
        if scene == self.scenes[self.at]:
            return self
        kept = slice(max(0, self.at + 1 - _DEPTH), self.at + 1)
        scenes = (*self.scenes[kept], scene)
        return _History(scenes, (*self.labels[kept], label), len(scenes) - 1)


class Editor:
    """A scene that is edited, by default an empty one, and its file.

    Raises:
        SceneError: A method that edits or selects was given an unknown id, or an edit that is not allowed. Then the
            scene is unchanged, and no listener is called.
    """

    def __init__(self, scene: Scene | None = None, *, file: Path | None = None) -> None:
        self.file = file  #: File of the scene; None: none yet.
        self.selection: tuple[int, ...] = ()  #: Ids of the selected objects, in order of selection.
        self.time_s = 0.0  #: Time of the slider, s.
        self._saved = scene or Scene()
        self._next_id = self._saved.next_id  # above the ids of all objects, also of undone ones
        self._history = _History((self._saved,))
        self._drag: _History | None = None  # history before the current drag
        self._listeners: list[Callable[[Change], None]] = []

    @classmethod
    def open(cls, file: Path) -> Editor:
        """Return an editor of a scene file; if it does not exist, of an empty scene that will be saved there.

        Raises:
            SceneError: The file exists and is no scene.
        """
        scene = load_scene(file) if file.exists() else Scene(name=file.stem or "scene")
        return cls(scene, file=file)

    @property
    def scene(self) -> Scene:
        """Current scene."""
        return self._history.scenes[self._history.at]

    @property
    def dirty(self) -> bool:
        """Whether the scene differs from the one that was loaded or saved last."""
        return self.scene != self._saved

    @property
    def undo_label(self) -> str | None:
        """Label of the step that undo takes back; None: there is none."""
        return self._history.label(self._history.at)

    @property
    def redo_label(self) -> str | None:
        """Label of the step that redo does again; None: there is none."""
        return self._history.label(self._history.at + 1)

    def listen(self, on_change: Callable[[Change], None]) -> Callable[[], None]:
        """Call a function, which must not raise, after each change; return a function that ends this."""
        self._listeners.append(on_change)

        def end() -> None:
            if on_change in self._listeners:
                self._listeners.remove(on_change)

        return end

    # Edits: each edit is one step, or a part of the current drag.

    def add(self, kind: str, name: str = "", *, parent: int = ROOT, **values: Any) -> int:
        """Add an object and return its id.

        Args:
            kind: Kind of the object, one of `KINDS`.
            name: Name for people.
            parent: Id of the object that holds it.
            values: Values of further fields, as Python values or as in a file.
        """
        if kind not in KINDS:
            raise SceneError("kind", kind, " or ".join(KINDS))
        id_ = self._next_id
        given = dict(id=id_, name=name, parent=parent, **values)
        made = read_object(KINDS[kind], given, f"{kind} {id_} ({name})")
        self._commit(f"Add {kind}", [*self.scene.objects.values(), made])
        return id_

    def add_trajectory(
        self, trajectory: Trajectory, name: str, *, agent: int | None = None, parent: int = ROOT
    ) -> int:
        """Add a trajectory with its waypoints, in the parent's frame, as one step; return its id."""
        id_ = self._next_id
        top = TrajectoryObject(
            id=id_, name=name, parent=parent, agent=agent, interpolation=trajectory.interpolation
        )
        made: list[SceneObject] = [top]
        for number, point in enumerate(trajectory.waypoints, id_ + 1):
            waypoint = WaypointObject(id=number, parent=id_, time_ns=point.time_ns, pose=point.pose)
            made.append(waypoint)
        self._commit("Add trajectory", [*self.scene.objects.values(), *map(changed, made)])
        return id_

    def insert_waypoint(
        self,
        trajectory: int,
        *,
        time_ns: int | None = None,
        pose: Pose | None = None,
        **values: Any,
    ) -> int:
        """Add a waypoint, by default a second after the last and on the path; return its id.

        Raises:
            SceneError: There is no such trajectory, or another waypoint has this time.
        """
        path = self.scene.trajectory(trajectory)
        if time_ns is None:
            time_ns = 0 if path is None else path.end_ns + NS_PER_S
        if pose is None:
            pose = Pose() if path is None else pose_at(path, time_ns / NS_PER_S)
        return self.add("waypoint", parent=trajectory, time_ns=time_ns, pose=pose, **values)

    def remove(self, *ids: int) -> None:
        """Remove objects with all that they hold, by default the selected ones.

        A trajectory stays if its agent is removed, without an agent.
        """
        chosen = ids or self.selection
        gone = set(chosen)
        for id_ in chosen:
            self.scene.get(id_)
            gone |= {thing.id for thing in self.scene.walk(id_)}
        left = []
        for thing in self.scene.objects.values():
            if thing.id in gone:
                continue
            is_lonely = isinstance(thing, TrajectoryObject) and thing.agent in gone
            left.append(changed(thing, agent=None) if is_lonely else thing)
        self._commit("Remove" if len(chosen) == 1 else f"Remove {len(chosen)} objects", left)

    def duplicate(self, id_: int) -> int:
        """Copy an object with all that it holds, after all others of its parent; return the copy's id.

        A copied trajectory has no agent, unless the agent is copied as well.

        Raises:
            SceneError: There is no object of this id, or it is a waypoint, whose copy would have its time.
        """
        original = self.scene.get(id_)
        copied = (original, *self.scene.walk(id_))
        new = {thing.id: self._next_id + i for i, thing in enumerate(copied)}
        copies = []
        for thing in copied:
            values: dict[str, Any] = {"id": new[thing.id]}
            values["parent"] = new.get(thing.parent, thing.parent)
            if isinstance(thing, TrajectoryObject):
                values["agent"] = new.get(thing.agent or ROOT)
            copies.append(replace(thing, **values))
        self._commit(f"Add {original.kind}", [*self.scene.objects.values(), *copies])
        return new[id_]

    def move(self, id_: int, parent: int) -> None:
        """Move an object to another parent, after the parent's other objects; its pose in the scene's frame stays."""
        thing = self.scene.get(id_)
        if parent == thing.parent:
            return
        pose = self.scene.world_pose(parent).inverse() @ self.scene.world_pose(id_)
        others = [one for one in self.scene.objects.values() if one.id != id_]
        moved = changed(thing, parent=parent, pose=pose)
        self._commit("Move in the tree", [*others, moved])

    def rename(self, id_: int, name: str) -> bool:
        """Give an object another name; return whether it changed."""
        return self.set_property(id_, "name", name)

    def set_pose(self, id_: int, pose: Pose) -> bool:
        """Set the pose of an object in its parent; an aligned waypoint keeps its orientation."""
        return self.set_property(id_, "pose", pose)

    def place(self, id_: int, world_pose: Pose) -> bool:
        """Set the pose of an object in the scene's frame."""
        parent = self.scene.world_pose(self.scene.get(id_).parent)
        return self.set_pose(id_, parent.inverse() @ world_pose)

    def set_waypoint_time(self, id_: int, time_ns: int) -> bool:
        """Set the time of a waypoint, ns; the order of the waypoints may change."""
        return self.set_property(id_, "time_ns", time_ns)

    def set_property(self, id_: int, key: str, value: Any) -> bool:
        """Change a field of an object, such as a radius, but not its id or kind; the value is as in `add`."""
        thing = self.scene.get(id_)
        if key == "id":
            raise SceneError(f"{place_of(thing)}, id", value, "another field")
        made = changed(thing, **{key: value})
        label = "Rename" if key == "name" else f"Change {key.removesuffix('_ns')}"
        return self._put(label, made)

    def align(self, id_: int, align: Align) -> bool:
        """Set the alignment of all waypoints of a trajectory (paper A, section 4.5)."""
        self.scene.of_kind(id_, TrajectoryObject)
        turned = [changed(waypoint, align=align) for waypoint in self.scene.waypoints(id_)]
        return self._put("Align waypoints", *turned)

    def set_scene(self, key: str, value: Any) -> bool:
        """Set one property of `SceneSettings`; return whether the scene changed."""
        own = {name: getattr(self.scene, name) for name in SETTINGS}
        made = read_object(SceneSettings, own | {key: value}, "scene")
        after = replace(self.scene, **{name: getattr(made, name) for name in SETTINGS})
        return self._do(f"Change {key}", after)

    def _put(self, label: str, *things: SceneObject) -> bool:
        """Commit the edit that replaces objects by those with the same ids."""
        objects = {**self.scene.objects, **{thing.id: thing for thing in things}}
        return self._commit(label, objects.values())

    def _commit(self, label: str, objects: Iterable[SceneObject]) -> bool:
        """Commit the edit whose result is a scene with these objects."""
        return self._do(label, scene_of(self.scene, objects))

    def _do(self, label: str, after: Scene) -> bool:
        """Set the next scene, as one step or as a part of the current drag; return whether it differs."""
        if after == self.scene:
            return False
        self._next_id = max(self._next_id, after.next_id)
        # Each edit of a drag replaces the one before; one that comes back leaves no step.
        before = self._history if self._drag is None else self._drag
        self._show(before.then(label, after), Change.EDIT)
        return True

    # Undo, redo and drags.

    def undo(self) -> bool:
        """Undo the last step and end the current drag; return whether there was a step."""
        return self._go(-1, self.undo_label, Change.UNDO)

    def redo(self) -> bool:
        """Redo the last undone step and end the current drag; return whether there was one."""
        return self._go(1, self.redo_label, Change.REDO)

    def _go(self, steps: int, label: str | None, change: Change) -> bool:
        self.end_drag()
        if label is not None:
            self._show(replace(self._history, at=self._history.at + steps), change)
        return label is not None

    def begin_drag(self) -> None:
        """Join the following edits into one step, until `end_drag`."""
        self._drag = self._history

    def end_drag(self) -> None:
        """End the drag; each of the following edits is a step again."""
        self._drag = None

    # Selection, time, warnings and file.

    def select(self, *ids: int) -> None:
        """Select these objects only."""
        for id_ in ids:
            self.scene.get(id_)
        chosen = tuple(dict.fromkeys(ids))
        if chosen != self.selection:
            self.selection = chosen
            self._tell(Change.SELECTION)

    def set_time(self, time_s: float) -> None:
        """Move the time slider to a time, s.

        Raises:
            SceneError: The time is no finite number.
        """
        if not float("-inf") < time_s < float("inf"):
            raise SceneError("time", time_s, "a finite number of seconds")
        self.time_s = float(time_s)
        self._tell(Change.TIME)

    def ghosts(self) -> tuple[Ghost, ...]:
        """Return the pose of each agent at the time of the slider."""
        return ghosts(self.scene, self.time_s)

    def conflicts(self) -> tuple[Conflict, ...]:
        """Return the warnings of the plan."""
        return conflicts(self.scene)

    def save(self, file: Path | None = None) -> None:
        """Save the scene, whole or not at all, into a file; None: the editor's.

        Raises:
            SceneError: There is no file, or it cannot be written; its former content is still there.
        """
        target = file or self.file
        if target is None:
            raise SceneError("file", None, "a file to save into")
        # Ids of a saved file are not used again, even if their addition has been undone since.
        save_scene(replace(self.scene, next_id=self._next_id), target)
        self.file, self._saved = target, self.scene
        self._tell(Change.SAVE)

    def load(self) -> None:
        """Load the scene from the editor's file; earlier steps cannot be undone.

        Raises:
            SceneError: There is no file, or it is no scene; the editor keeps its scene.
        """
        if self.file is None:
            raise SceneError("file", None, "a file to load")
        scene = load_scene(self.file)
        self._saved, self._next_id = scene, scene.next_id
        self.end_drag()
        self._show(_History((scene,)), Change.LOAD)

    def _show(self, history: _History, change: Change) -> None:
        """Set another history, and notify the listeners of the change."""
        self._history = history
        self.selection = tuple(id_ for id_ in self.selection if id_ in self.scene.objects)
        self._tell(change)

    def _tell(self, change: Change) -> None:
        for on_change in tuple(self._listeners):
            on_change(change)
