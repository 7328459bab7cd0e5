"""The toolbar: add, remove, undo and save. Viser's palette has some of these commands with keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose, Vec3
from sfglab.spatial.scene.editor import Change, Editor
from sfglab.spatial.scene.model import (
    ROOT,
    AgentObject,
    Box,
    Group,
    SceneError,
    WaypointObject,
)
from sfglab.spatial.trajectory.path import Align, Trajectory
from sfglab.units import NS_PER_S
from sfglab.view.planner.context import Context, Part
from sfglab.view.planner.looks import open_trajectory
from sfglab.view.planner.panels import assign

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.scene.tree import Scene

#: Kinds of objects that the toolbar adds.
ADDABLE = ("agent", "obstacle", "zone", "trajectory", "group")
_AHEAD = Pose(position_m=(1.0, 0.0, 0.0))
_LIFT_M = {"agent": 0.3, "obstacle": 0.5, "zone": 0.5}


def add(editor: Editor, kind: str, at_m: Vec3) -> int:
    """Add an object of one of `ADDABLE`, select it and return its id.

    The object is put into the selected group, if any. A trajectory begins at the selected agent, if any.

    Args:
        editor: Editor of the scene.
        kind: Kind of the object.
        at_m: Place near which the object is put, x, y, z in the scene's frame, metres.
    """
    scene = editor.scene
    parent = next((i for i in editor.selection if isinstance(scene.get(i), Group)), ROOT)
    agent = _agent_without_trajectory(editor) if kind == "trajectory" else None
    x, y, z = at_m
    pose = Pose(position_m=(x, y, z + _LIFT_M.get(kind, 0.0)))
    if agent is not None:
        pose = scene.world_pose(agent)
    pose = scene.world_pose(parent).inverse() @ pose
    name = _free_name(scene, kind)
    if kind == "trajectory":
        path = Trajectory.of([(0, pose), (2 * NS_PER_S, pose @ _AHEAD @ _AHEAD)])
        id_ = editor.add_trajectory(path, name, agent=agent, parent=parent)
    else:
        shape = {"shape": Box(size_m=(1.0, 1.0, 1.0))} if kind in {"obstacle", "zone"} else {}
        id_ = editor.add(kind, name, parent=parent, pose=pose, **shape)
    editor.select(id_)
    return id_


def append_waypoint(editor: Editor) -> None:
    """Add a waypoint a second after the last one of the open trajectory and a metre ahead; select it."""
    id_ = _opened(editor)
    waypoints = editor.scene.waypoints(id_)
    pose = waypoints[-1].pose @ _AHEAD if waypoints else None
    align = waypoints[-1].align if waypoints else Align.NEXT
    editor.select(editor.insert_waypoint(id_, pose=pose, align=align))


def insert_waypoint(editor: Editor) -> None:
    """Add a waypoint on the open trajectory, at the time of the slider, and select it."""
    time_ns = round(editor.time_s * NS_PER_S)
    editor.select(editor.insert_waypoint(_opened(editor), time_ns=time_ns, align=Align.NEXT))


def remove(editor: Editor) -> None:
    """Remove the selected objects, and select the trajectories of removed waypoints."""
    removed = [editor.scene.get(id_) for id_ in editor.selection]
    editor.remove()
    held = [thing.parent for thing in removed if isinstance(thing, WaypointObject)]
    editor.select(*(id_ for id_ in held if id_ in editor.scene.objects))


def duplicate(editor: Editor) -> None:
    """Copy the selected objects, and select the copies."""
    editor.select(*[editor.duplicate(id_) for id_ in editor.selection])


def reload(editor: Editor) -> None:
    """Read the scene's file again.

    Raises:
        SceneError: Unsaved changes would be lost, or the file is no scene.
    """
    if editor.dirty:
        raise SceneError("scene", "unsaved changes", "a saved scene, or undo")
    editor.load()


def _agent_without_trajectory(editor: Editor) -> int | None:
    scene = editor.scene
    for id_ in editor.selection:
        if isinstance(scene.get(id_), AgentObject) and scene.driven_by(id_) is None:
            return id_
    return None


def _opened(editor: Editor) -> int:
    found = open_trajectory(editor.scene, editor.selection)
    if found is None:
        raise SceneError("selection", None, "a selected trajectory, to add a waypoint to")
    return found


def _free_name(scene: Scene, kind: str) -> str:
    taken = {thing.name for thing in scene.objects.values()}
    return next(name for i in range(1, len(taken) + 2) if (name := f"{kind} {i}") not in taken)


# Buttons are in pairs; all other widgets have the whole width.
_STYLE = """<style>
div:has(> * > .sfg-tools) { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); }
div:has(> * > .sfg-tools) > :not(:has(> button)) { grid-column: 1 / -1; }
div:has(> * > .sfg-tools) > :has(> button) { margin-inline: 0.4em !important; }
div:has(> * > .sfg-tools) > * > button { padding-inline: 0.3em; }
</style><span class="sfg-tools"></span>"""
_WAYPOINT = {"append": append_waypoint, "at this time": insert_waypoint}
_SELECTED = {"duplicate": duplicate, "remove": remove}
_KEYS: dict[str, tuple[str, str | None, Callable[[Editor], object]]] = {
    "Undo": ("Z", "cmd/ctrl", Editor.undo),
    "Redo": ("Z", "cmd/ctrl+shift", Editor.redo),
    "Save": ("S", "cmd/ctrl", Editor.save),
    "Remove": ("delete", None, remove),
}


class Toolbar(Part):
    """Buttons of the planner's toolbar."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        icon = context.viser.Icon
        with self._gui.add_folder("Edit"):
            self._gui.add_html(_STYLE)
            self._group("add", ADDABLE, lambda given: add(self._editor, *given))
            self._group("waypoint", _WAYPOINT, lambda given: _WAYPOINT[given[0]](self._editor))
            self._group("selected", _SELECTED, lambda given: _SELECTED[given[0]](self._editor))
            self._undo = self._button("Undo", icon.ARROW_BACK_UP, Editor.undo)
            self._redo = self._button("Redo", icon.ARROW_FORWARD_UP, Editor.redo)
            self._save = self._button("Save", icon.DEVICE_FLOPPY, Editor.save)
            self._load = self._button("Reload", icon.REFRESH, reload)
        for label, (key, modifier, job) in _KEYS.items():
            made = self._gui.add_command(label, hotkey=key, modifier=modifier)
            made.on_trigger(self._does(job))
        self._draw()

    def show(self, change: Change) -> None:
        """Show the labels of undo and redo, and whether the scene is saved."""
        if change not in {Change.TIME, Change.SELECTION}:
            self._draw()

    def _draw(self) -> None:
        editor = self._editor
        undo, redo = editor.undo_label, editor.redo_label
        assign(self._undo, "label", f"Undo: {undo}" if undo else "Undo")
        assign(self._undo, "disabled", undo is None)
        assign(self._redo, "label", f"Redo: {redo}" if redo else "Redo")
        assign(self._redo, "disabled", redo is None)
        assign(self._save, "label", "Save *" if editor.dirty else "Save")
        assign(self._save, "disabled", editor.file is None)
        assign(self._load, "disabled", editor.file is None or editor.dirty)
        name = editor.scene.name if editor.file is None else editor.file.name
        self._gui.set_panel_label(f"{name} * not saved" if editor.dirty else name)

    def _group(self, label: str, words: Any, job: Callable[[tuple[str, Vec3]], object]) -> None:
        made = self._gui.add_button_group(label, tuple(words))
        made.on_click(
            self._context.on(job, read=lambda event: (event.target.value, _seen(event.client)))
        )

    def _button(self, label: str, icon: str, job: Callable[[Editor], object]) -> Any:
        made = self._gui.add_button(label, icon=icon)
        made.on_click(self._does(job))
        return made

    def _does(self, job: Callable[[Editor], object]) -> Any:
        return self._context.on(lambda _: job(self._editor))


def _seen(client: Any) -> Vec3:
    """Return the target of a browser's camera on the floor, to the nearest decimetre."""
    x, y, _ = (round(float(c), 1) + 0.0 for c in client.camera.look_at)
    return (x, y, 0.0)
