"""The toolbar: add, remove, undo and save. Viser's palette has some of these commands with keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.spatial.poses import Pose, Vec3
from sfglab.spatial.scene.editor import Change, ChangeKind, Editor
from sfglab.spatial.scene.model import (
    ROOT,
    AgentObject,
    Box,
    Group,
    SceneError,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.trajectory.path import Align, Trajectory
from sfglab.units import NS_PER_S
from sfglab.view.planner.context import Context, Part
from sfglab.view.planner.looks import open_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.scene.tree import Scene

ADDABLE = (
    "agent",
    "obstacle",
    "zone",
    "trajectory",
    "group",
)  #: Kinds of objects that the toolbar adds.
_STEP_S = 2.0
_STEP_M = 1.0


def add(editor: Editor, kind: str, at_m: Vec3) -> int:
    """Add an object of one of `ADDABLE`, select it and return its id.

    It is in the selected group, if any, near a place in the scene's frame. A trajectory begins at the selected
    agent, if any.
    """
    scene = editor.scene
    parent = next((i for i in editor.selection if isinstance(scene.get(i), Group)), ROOT)
    name = _free_name(scene, kind)
    if kind == "trajectory":
        id_ = _add_trajectory(editor, name, at_m, parent)
    else:
        x, y, z = at_m
        lift = {"agent": 0.3, "obstacle": 0.5, "zone": 0.5}.get(kind, 0.0)
        pose = scene.world_pose(parent).inverse() @ Pose(position_m=(x, y, z + lift))
        shape = {"shape": Box(size_m=(1.0, 1.0, 1.0))} if kind in {"obstacle", "zone"} else {}
        id_ = editor.add(kind, name, parent=parent, pose=pose, **shape)
    editor.select(id_)
    return id_


def add_waypoint(editor: Editor) -> int:
    """Add a waypoint after the last one of the open trajectory, and select it."""
    id_ = _worked_on(editor)
    path = editor.scene.trajectory(id_)
    if path is None:
        made = editor.insert_waypoint(id_, align=Align.NEXT)
    else:
        last = path.waypoints[-1]
        ahead = np.array(last.pose.apply((_STEP_M, 0.0, 0.0)))
        if len(path.waypoints) > 1:
            way = np.subtract(last.pose.position_m, path.waypoints[-2].pose.position_m)
            ahead = np.array(last.pose.position_m) + way
        pose = Pose.at(ahead.tolist(), last.pose.quat_xyzw)
        before = (
            path.waypoints[-2].time_ns if len(path.waypoints) > 1 else last.time_ns - 2 * NS_PER_S
        )
        align = editor.scene.of_kind(editor.scene.held_by(id_)[-1], WaypointObject).align
        made = editor.insert_waypoint(
            id_, time_ns=2 * last.time_ns - before, pose=pose, align=align
        )
    editor.select(made)
    return made


def insert_waypoint(editor: Editor) -> int:
    """Add a waypoint on the open trajectory, at the time of the slider, and select it."""
    id_ = _worked_on(editor)
    made = editor.insert_waypoint(
        id_, time_ns=max(0, round(editor.time_s * NS_PER_S)), align=Align.NEXT
    )
    editor.select(made)
    return made


def _add_trajectory(editor: Editor, name: str, at_m: Vec3, parent: int) -> int:
    scene = editor.scene
    agents = (i for i in editor.selection if isinstance(scene.get(i), AgentObject))
    agent = next((i for i in agents if scene.driven_by(i) is None), None)
    start = Pose(position_m=at_m) if agent is None else scene.world_pose(agent)
    start = scene.world_pose(parent).inverse() @ start
    end = Pose(position_m=start.apply((_STEP_S * _STEP_M, 0.0, 0.0)), quat_xyzw=start.quat_xyzw)
    path = Trajectory.of([(0, start), (round(_STEP_S * NS_PER_S), end)])
    return editor.add_trajectory(path, name, agent=agent, parent=parent)


def _worked_on(editor: Editor) -> int:
    found = open_trajectory(editor.scene, editor.selection)
    if found is None:
        driven = (editor.scene.driven_by(i) for i in editor.selection if i in editor.scene.objects)
        found = next((t.id for t in driven if t is not None), None)
    if found is None:
        one = [t.id for t in editor.scene.all_of(TrajectoryObject)]
        if len(one) != 1:
            raise SceneError("selection", None, "a selected trajectory, to add a waypoint to")
        found = one[0]
    return found


def _free_name(scene: Scene, kind: str) -> str:
    taken = {thing.name for thing in scene.objects.values()}
    return next(name for i in range(1, len(taken) + 2) if (name := f"{kind} {i}") not in taken)


# Buttons in pairs, everything else over the whole width.
_STYLE = """<style>
div:has(> * > .sfg-tools) { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); }
div:has(> * > .sfg-tools) > :not(:has(> button)) { grid-column: 1 / -1; }
div:has(> * > .sfg-tools) > :has(> button) { margin-inline: 0.4em !important; }
div:has(> * > .sfg-tools) > * > button { padding-inline: 0.3em; }
</style><span class="sfg-tools"></span>"""


class Toolbar(Part):
    """The buttons of the toolbar."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context, container)
        gui, icon, editor = context.server.gui, context.viser.Icon, context.editor
        with container, gui.add_folder("Edit"):
            gui.add_html(_STYLE)
            self._group("add", ADDABLE, self._add)
            ways = {"append": add_waypoint, "at this time": insert_waypoint}
            self._group("waypoint", tuple(ways), lambda given: ways[given[0]](editor))
            self._group("selected", ("duplicate", "remove"), self._selected)
            self._undo = self._button("Undo", icon.ARROW_BACK_UP, lambda _: editor.undo())
            self._redo = self._button("Redo", icon.ARROW_FORWARD_UP, lambda _: editor.redo())
            self._save = self._button("Save", icon.DEVICE_FLOPPY, lambda _: editor.save())
            self._load = self._button("Reload", icon.REFRESH, lambda _: self._reload())
        self._palette()
        self._draw()

    def show(self, change: Change) -> None:
        """Show the labels of undo and redo, and whether the scene is saved."""
        if change.kind not in {ChangeKind.TIME, ChangeKind.SELECTION}:
            self._draw()

    def _draw(self) -> None:
        editor = self._context.editor
        dirty = editor.dirty
        for button, word, label in (
            (self._undo, "Undo", editor.undo_label),
            (self._redo, "Redo", editor.redo_label),
        ):
            _set(button, "label", f"{word}: {label}" if label else word)
            _set(button, "disabled", label is None)
        _set(self._save, "label", "Save *" if dirty else "Save")
        _set(self._save, "disabled", editor.file is None)
        _set(self._load, "disabled", editor.file is None)
        name = editor.scene.name if editor.file is None else editor.file.name
        self._context.server.gui.set_panel_label(f"{name} * not saved" if dirty else name)

    def _group(
        self, label: str, words: tuple[str, ...], job: Callable[[tuple[str, Vec3]], object]
    ) -> None:
        made = self._context.server.gui.add_button_group(label, words)
        made.on_click(
            self._context.on(job, read=lambda event: (event.target.value, _seen(event.client)))
        )

    def _button(self, label: str, icon: str, job: Callable[[Any], object]) -> Any:
        made = self._context.server.gui.add_button(label, icon=icon)
        made.on_click(self._context.on(job))
        return made

    def _add(self, given: tuple[str, Vec3]) -> None:
        add(self._context.editor, *given)

    def _selected(self, given: tuple[str, Vec3]) -> None:
        editor = self._context.editor
        if given[0] == "remove":
            above = {editor.scene.get(i).parent for i in editor.selection}
            below = all(isinstance(editor.scene.get(i), WaypointObject) for i in editor.selection)
            editor.remove()
            if below and above:
                editor.select(*above)
        elif editor.selection:
            editor.select(*(editor.duplicate(id_) for id_ in editor.selection))

    def _reload(self) -> None:
        """Load the file again; ask first if edits would be lost."""
        editor, gui = self._context.editor, self._context.server.gui
        if not editor.dirty:
            editor.load()
            return
        with gui.add_modal("Discard what is not saved?") as modal:
            gui.add_markdown("The scene goes back to what the file holds. This cannot be undone.")
            discard = gui.add_button("Discard and reload", color="red")
            keep = gui.add_button("Keep editing", color="gray")

        def load(_: object) -> None:
            modal.close()
            editor.load()

        discard.on_click(self._context.on(load))
        keep.on_click(self._context.on(lambda _: modal.close()))

    def _palette(self) -> None:
        editor = self._context.editor
        for label, key, modifier, job in (
            ("Undo", "Z", "cmd/ctrl", lambda _: editor.undo()),
            ("Redo", "Z", "cmd/ctrl+shift", lambda _: editor.redo()),
            ("Save", "S", "cmd/ctrl", lambda _: editor.save()),
            ("Select nothing", "escape", None, lambda _: editor.select()),
        ):
            made = self._context.server.gui.add_command(label, hotkey=key, modifier=modifier)
            made.on_trigger(self._context.on(job))


def _set(widget: Any, name: str, value: object) -> None:
    if getattr(widget, name) != value:
        setattr(widget, name, value)


def _seen(client: Any) -> Vec3:
    """Return the target of a browser's camera on the floor, to the nearest decimetre."""
    x, y, _ = (round(float(c), 1) + 0.0 for c in client.camera.look_at)
    return (x, y, 0.0)
