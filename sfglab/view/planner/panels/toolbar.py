"""The toolbar: add, remove, undo, save; its commands also stand in viser's palette, with keys."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene import ChangeKind, WaypointObject
from sfglab.view.planner.making import ADDABLE, add, add_waypoint, insert_waypoint

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.poses import Vec3
    from sfglab.spatial.scene import Change
    from sfglab.view.planner.bench import Bench


# Buttons in pairs, everything else over the whole width.
_STYLE = """<style>
div:has(> * > .sfg-tools) { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); }
div:has(> * > .sfg-tools) > :not(:has(> button)) { grid-column: 1 / -1; }
div:has(> * > .sfg-tools) > :has(> button) { margin-inline: 0.4em !important; }
div:has(> * > .sfg-tools) > * > button { padding-inline: 0.3em; }
</style><span class="sfg-tools"></span>"""


class Toolbar:
    """The buttons.

    Args:
        bench: What it works with.
        container: A context that widgets are put into.
    """

    def __init__(self, bench: Bench, container: Any) -> None:
        self._bench = bench
        gui, icon, editor = bench.server.gui, bench.viser.Icon, bench.editor
        with container, gui.add_folder("Edit"):
            gui.add_html(_STYLE)
            self._group("add", ADDABLE, self._add)
            self._group("waypoint", ("append", "at this time"), self._waypoint)
            self._group("selected", ("duplicate", "remove"), self._selected)
            self._undo = self._button("Undo", icon.ARROW_BACK_UP, lambda _: editor.undo())
            self._redo = self._button("Redo", icon.ARROW_FORWARD_UP, lambda _: editor.redo())
            self._save = self._button("Save", icon.DEVICE_FLOPPY, lambda _: editor.save())
            self._load = self._button("Reload", icon.REFRESH, lambda _: self._reload())
        self._palette()
        self._draw()

    def show(self, change: Change) -> None:
        """Show what can be undone, and whether the file is as the scene."""
        if change.kind not in {ChangeKind.TIME, ChangeKind.SELECTION}:
            self._draw()

    def _draw(self) -> None:
        editor = self._bench.editor
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
        self._bench.server.gui.set_panel_label(f"{name} * not saved" if dirty else name)

    def _group(self, label: str, words: tuple[str, ...], job: Callable[[tuple[str, Vec3]], object]) -> None:
        made = self._bench.server.gui.add_button_group(label, words)
        made.on_click(self._bench.on(job, read=lambda event: (event.target.value, _seen(event.client))))

    def _button(self, label: str, icon: str, job: Callable[[Any], object]) -> Any:
        made = self._bench.server.gui.add_button(label, icon=icon)
        made.on_click(self._bench.on(job))
        return made

    def _add(self, given: tuple[str, Vec3]) -> None:
        add(self._bench.editor, *given)

    def _waypoint(self, given: tuple[str, Vec3]) -> None:
        (add_waypoint if given[0] == "append" else insert_waypoint)(self._bench.editor)

    def _selected(self, given: tuple[str, Vec3]) -> None:
        editor = self._bench.editor
        if given[0] == "remove":
            above = {editor.scene.get(i).parent for i in editor.selection}
            below = all(isinstance(editor.scene.get(i), WaypointObject) for i in editor.selection)
            editor.remove()
            if below and above:
                editor.select(*above)
        elif editor.selection:
            editor.select(*(editor.duplicate(id_) for id_ in editor.selection))

    def _reload(self) -> None:
        """Load the file again; where that loses edits, ask first."""
        editor, gui = self._bench.editor, self._bench.server.gui
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

        discard.on_click(self._bench.on(load))
        keep.on_click(self._bench.on(lambda _: modal.close()))

    def _palette(self) -> None:
        editor = self._bench.editor
        for label, key, modifier, job in (
            ("Undo", "Z", "cmd/ctrl", lambda _: editor.undo()),
            ("Redo", "Z", "cmd/ctrl+shift", lambda _: editor.redo()),
            ("Save", "S", "cmd/ctrl", lambda _: editor.save()),
            ("Select nothing", "escape", None, lambda _: editor.select()),
        ):
            made = self._bench.server.gui.add_command(label, hotkey=key, modifier=modifier)
            made.on_trigger(self._bench.on(job))


def _set(widget: Any, name: str, value: object) -> None:
    if getattr(widget, name) != value:
        setattr(widget, name, value)


def _seen(client: Any) -> Vec3:
    """Return what a browser's camera looks at, on the floor, to the nearest decimetre."""
    x, y, _ = (round(float(c), 1) + 0.0 for c in client.camera.look_at)
    return (x, y, 0.0)
