"""The list of objects: a row each, indented as in the tree; a click selects, a second one selects none."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene import ChangeKind
from sfglab.view.planner.rows import TreeRow, rows_of

if TYPE_CHECKING:
    from sfglab.spatial.scene import Change
    from sfglab.view.planner.bench import Bench


_ICONS = {
    "group": "FOLDER",
    "agent": "ROBOT",
    "obstacle": "CUBE",
    "zone": "BARRIER_BLOCK",
    "trajectory": "ROUTE",
    "waypoint": "MAP_PIN",
}
_INDENT = "\u2003"
# Rows instead of buttons: flush left, filled only where selected.
_STYLE = """<style>
div:has(> * > .sfg-rows) > div { padding-bottom: 1px !important; }
div:has(> * > .sfg-rows) button { height: 1.9em !important; }
div:has(> * > .sfg-rows) button:not([style*="--button-bg"]) { background: transparent; color: inherit; }
div:has(> * > .sfg-rows) button:not([style*="--button-bg"]):hover { background: rgba(128,128,128,0.15); }
div:has(> * > .sfg-rows) .mantine-Button-inner { justify-content: flex-start; }
</style><span class="sfg-rows"></span>"""


class Hierarchy:
    """The rows, in the container that is open when it is made.

    Args:
        bench: What it works with.
        container: A context that widgets are put into.
    """

    def __init__(self, bench: Bench, container: Any) -> None:
        self._bench = bench
        self._container = container
        self._rows: dict[int, tuple[int, TreeRow]] = {}
        self._buttons: dict[int, Any] = {}
        with container:
            bench.server.gui.add_html(_STYLE, order=-1)
        self._draw()

    def show(self, change: Change) -> None:
        """Show rows that are new, gone, elsewhere or called otherwise."""
        if change.kind not in {ChangeKind.TIME, ChangeKind.SAVE}:
            self._draw()

    def _draw(self) -> None:
        editor = self._bench.editor
        rows = {row.id: (i, row) for i, row in enumerate(rows_of(editor.scene, editor.selection))}
        for id_ in self._rows.keys() - rows.keys():
            self._buttons.pop(id_).remove()
        for id_, (position, row) in rows.items():
            if self._rows.get(id_) != (position, row):
                self._put(position, row)
        self._rows = rows

    def _put(self, position: int, row: TreeRow) -> None:
        label = _INDENT * row.depth + row.text
        colour = "blue" if row.selected else None
        button = self._buttons.get(row.id)
        if button is None:
            icon = getattr(self._bench.viser.Icon, _ICONS[row.kind])
            with self._container:
                button = self._bench.server.gui.add_button(label, icon=icon, color=colour, order=position)
            button.on_click(self._bench.on(lambda _: self._clicked(row.id)))
            self._buttons[row.id] = button
            return
        for name, value in (("label", label), ("color", colour), ("order", position)):
            if getattr(button, name) != value:
                setattr(button, name, value)

    def _clicked(self, id_: int) -> None:
        editor = self._bench.editor
        if id_ in editor.scene.objects:
            editor.select(*(() if editor.selection == (id_,) else (id_,)))
