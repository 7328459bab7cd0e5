"""An editor without a screen: a scene, its history, selection, time and file, and who wants to hear of changes.

A browser, a notebook or a test calls methods, in one thread, and listens; all decisions are here.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.commands import Add, Command, History, Remove, SetPose, Step
from sfglab.spatial.scene.conflicts import Conflict, Ghost, conflicts, ghosts
from sfglab.spatial.scene.files import load_scene, save_scene
from sfglab.spatial.scene.objects import (
    KINDS,
    ROOT,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    place_of,
)
from sfglab.spatial.scene.tree import Scene
from sfglab.spatial.trajectory.motion import pose_at
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from sfglab.spatial.trajectory.path import Trajectory


class ChangeKind(Enum):
    """What happened."""

    EDIT = "edit"  #: A command was done.
    UNDO = "undo"  #: A step was taken back.
    REDO = "redo"  #: A step was done again.
    LOAD = "load"  #: Another scene is here.
    SAVE = "save"  #: The scene is on disk.
    SELECTION = "selection"  #: Other objects are selected.
    TIME = "time"  #: The time slider moved.


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """What listeners hear."""

    kind: ChangeKind  #: What happened.
    label: str = ""  #: Of the step, where it is one.
    added: tuple[int, ...] = ()  #: Ids that are new.
    removed: tuple[int, ...] = ()  #: Ids that are gone.
    #: Ids whose object, or what it holds, changed; 0 is the scene itself.
    changed: tuple[int, ...] = ()


class Editor:
    """A scene that is being edited, an empty one if none is given, and the file where it is saved, if any yet.

    Raises:
        SceneError: By every method that edits or selects: an id that no object has, or something that is not
            allowed; nothing changed, and nobody is called.
    """

    def __init__(self, scene: Scene | None = None, *, file: Path | None = None) -> None:
        self.file = file  #: Where it is saved.
        self.selection: tuple[int, ...] = ()  #: Ids of what is selected, in the order of selecting.
        self.time_s = 0.0  #: Where the time slider stands.
        self._history = History(scene or Scene())
        self._saved = self._history.scene
        self._written_next_id = self._history.scene.next_id
        self._listeners: list[Callable[[Change], None]] = []
        self._drag: str | None = None
        self._drags = 0

    @classmethod
    def open(cls, file: Path) -> Editor:
        """Return an editor of a scene file; where there is none, of an empty scene that will be saved there.

        Raises:
            SceneError: The file is there and is no scene.
        """
        return cls(
            load_scene(file) if file.exists() else Scene(name=file.stem or "scene"), file=file
        )

    @property
    def scene(self) -> Scene:
        """The scene as it is now."""
        return self._history.scene

    @property
    def dirty(self) -> bool:
        """Whether the scene is another one than was loaded or saved last."""
        return self.scene != self._saved

    @property
    def undo_label(self) -> str | None:
        """What undo would take back, None where there is nothing."""
        return self._history.undo_label

    @property
    def redo_label(self) -> str | None:
        """What redo would do again, None where there is nothing."""
        return self._history.redo_label

    def listen(self, listener: Callable[[Change], None]) -> Callable[[], None]:
        """Call somebody, who must not raise, after every change with what happened; return what ends it."""
        self._listeners.append(listener)

        def end() -> None:
            if listener in self._listeners:
                self._listeners.remove(listener)

        return end

    def do(self, command: Command) -> bool:
        """Do an edit, and return whether anything changed."""
        before = self.scene
        done = self._history.do(command, drag=self._drag)
        if done:
            self._tell_difference(ChangeKind.EDIT, command.label, before)
        return done

    def undo(self) -> bool:
        """Take the last step back, and end a drag that goes on; return whether there was one."""
        return self._stepped(ChangeKind.UNDO, self._history.undo)

    def redo(self) -> bool:
        """Do the last undone step again; return whether there was one."""
        return self._stepped(ChangeKind.REDO, self._history.redo)

    def _stepped(self, kind: ChangeKind, step_of: Callable[[], Step | None]) -> bool:
        self.end_drag()
        before = self.scene
        step = step_of()
        if step is not None:
            self._tell_difference(kind, step.label, before)
        return step is not None

    def begin_drag(self) -> None:
        """Make what is done from here on one step, until `end_drag`."""
        self._drags += 1
        self._drag = f"drag {self._drags}"

    def end_drag(self) -> None:
        """Let what is done from here on be steps of its own."""
        self._drag = None

    @contextmanager
    def drag(self) -> Iterator[None]:
        """Make what is done inside one step."""
        self.begin_drag()
        try:
            yield
        finally:
            self.end_drag()

    def add(self, kind: str, name: str, *, parent: int = ROOT, **values: Any) -> int:
        """Add an object of one of `KINDS` with values of its fields, typed or plain, and return its id."""
        if kind not in KINDS:
            raise SceneError("kind", kind, " or ".join(KINDS))
        made = KINDS[kind]
        allowed = [f.name for f in fields(made) if f.name not in {"id", "name", "parent"}]
        for key in values:
            if key not in allowed:
                raise SceneError(f"{kind} ({name}), property", key, " or ".join(allowed))
        id_ = self._history.next_id
        self.do(Add(objects=(made(id=id_, name=name, parent=parent, **values),)))
        return id_

    def add_trajectory(
        self, trajectory: Trajectory, name: str, *, agent: int | None = None, parent: int = ROOT
    ) -> int:
        """Add a trajectory with its waypoints, in the parent's frame, as one step; return its id."""
        id_ = self._history.next_id
        top = TrajectoryObject(
            id=id_, name=name, parent=parent, agent=agent, interpolation=trajectory.interpolation
        )
        held = (
            WaypointObject(id=id_ + i, parent=id_, time_ns=w.time_ns, pose=w.pose)
            for i, w in enumerate(trajectory.waypoints, 1)
        )
        self.do(Add(objects=(top, *held)))
        return id_

    def insert_waypoint(
        self,
        trajectory: int,
        *,
        time_ns: int | None = None,
        pose: Pose | None = None,
        **values: Any,
    ) -> int:
        """Add a waypoint, by default a second after the last and where the trajectory is then; return its id.

        Raises:
            SceneError: There is no such trajectory, or another waypoint has this time.
        """
        path = self.scene.trajectory(trajectory)
        if time_ns is None:
            time_ns = 0 if path is None else path.end_ns + NS_PER_S
        if pose is None:
            pose = Pose() if path is None else pose_at(path, time_ns / NS_PER_S)
        return self.add("waypoint", "", parent=trajectory, time_ns=time_ns, pose=pose, **values)

    def remove(self, *ids: int) -> None:
        """Remove objects with all they hold, what is selected where none is named."""
        chosen = ids or self.selection
        if chosen:
            self.do(Remove(ids=chosen))

    def duplicate(self, id_: int) -> int:
        """Copy an object with all it holds, but no agent from outside, beside it; return the copy's id.

        Raises:
            SceneError: There is no object of this id, or it is a waypoint, whose copy would have its time.
        """
        original = self.scene.get(id_)
        if isinstance(original, WaypointObject):
            raise SceneError(
                place_of(original), "a copy at the same time", "a new waypoint at another time"
            )
        copied = (original, *self.scene.walk(id_))
        new = {thing.id: self._history.next_id + i for i, thing in enumerate(copied)}
        copies = tuple(_copy(thing, new) for thing in copied)
        self.do(Add(objects=copies, index=self.scene.held_by(original.parent).index(id_) + 1))
        return new[id_]

    def place(self, id_: int, world_pose: Pose) -> None:
        """Put an object where a gizmo in the scene's frame says."""
        parent = self.scene.world_pose(self.scene.get(id_).parent)
        self.do(SetPose(id=id_, pose=parent.inverse() @ world_pose))

    def select(self, *ids: int) -> None:
        """Select objects, and only these."""
        for id_ in ids:
            self.scene.get(id_)
        chosen = tuple(dict.fromkeys(ids))
        if chosen != self.selection:
            self.selection = chosen
            self._tell(Change(kind=ChangeKind.SELECTION))

    def set_time(self, time_s: float) -> None:
        """Move the time slider; SceneError where it is no finite number."""
        if not float("-inf") < time_s < float("inf"):
            raise SceneError("time", time_s, "a finite number of seconds")
        self.time_s = float(time_s)
        self._tell(Change(kind=ChangeKind.TIME))

    def ghosts(self) -> tuple[Ghost, ...]:
        """Return every agent at the slider's time."""
        return ghosts(self.scene, self.time_s)

    def conflicts(self) -> tuple[Conflict, ...]:
        """Return what is wrong with the plan."""
        return conflicts(self.scene)

    def save(self, file: Path | None = None) -> None:
        """Save the scene, whole or not at all, into a file, from now on its own; None: where it was last.

        Raises:
            SceneError: No file was ever named, or it cannot be written; what was there is still there.
        """
        target = file or self.file
        if target is None:
            raise SceneError("file", None, "a file to save into")
        scene = self.scene
        # ids that a saved file once held are not given out again, also when their addition was undone since
        next_id = max(scene.next_id, self._written_next_id)
        save_scene(replace(scene, next_id=next_id), target)
        self.file, self._saved, self._written_next_id = target, scene, next_id
        self._tell(Change(kind=ChangeKind.SAVE))

    def load(self, file: Path | None = None) -> None:
        """Load a scene in place of this one; None: what was saved last. Nothing before it can be undone.

        Raises:
            SceneError: No file was ever named, or it is no scene; the editor keeps what it has.
        """
        source = file or self.file
        if source is None:
            raise SceneError("file", None, "a file to load")
        before, scene = self.scene, load_scene(source)
        self.file, self._saved, self._written_next_id = source, scene, scene.next_id
        self._history = History(scene)
        self.end_drag()
        self._tell_difference(ChangeKind.LOAD, "", before)

    def _tell_difference(self, kind: ChangeKind, label: str, before: Scene) -> None:
        after = self.scene
        common = before.objects.keys() & after.objects.keys()
        changed = {i for i in common if before.objects[i] != after.objects[i]}
        changed |= {i for i in {ROOT, *common} if before.held_by(i) != after.held_by(i)}
        if any(
            getattr(before, key) != getattr(after, key) for key in ("name", "frame_id", "margin_m")
        ):
            changed.add(ROOT)
        self.selection = tuple(i for i in self.selection if i in after.objects)
        self._tell(
            Change(
                kind=kind,
                label=label,
                added=tuple(sorted(after.objects.keys() - before.objects.keys())),
                removed=tuple(sorted(before.objects.keys() - after.objects.keys())),
                changed=tuple(sorted(changed)),
            )
        )

    def _tell(self, change: Change) -> None:
        for listener in tuple(self._listeners):
            listener(change)


def _copy(thing: SceneObject, new: dict[int, int]) -> SceneObject:
    copy = replace(thing, id=new[thing.id], parent=new.get(thing.parent, thing.parent))
    if isinstance(copy, TrajectoryObject):
        copy = replace(copy, agent=new.get(copy.agent or ROOT))
    return copy
