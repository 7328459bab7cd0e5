"""The property inspector: a widget for each field of what is selected, or of the scene.

What is typed becomes an edit when nobody has typed for a moment; a refused value is said, and the field shows
what the scene has. Refuses to know what properties there are (`forms`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene import ROOT, ChangeKind, Retime, TrajectoryObject
from sfglab.view.planner.fields import Field, FieldKind
from sfglab.view.planner.forms import fields_of
from sfglab.view.planner.rows import title_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.scene import Change
    from sfglab.view.planner.bench import Bench


_TYPING_S = 0.5
_STEP = 0.05


class Inspector:
    """The fields of one object.

    Args:
        bench: What it works with.
        container: A context that widgets are put into.
    """

    def __init__(self, bench: Bench, container: Any) -> None:
        self._bench = bench
        self._container = container
        self._makers: dict[FieldKind, Callable[[Field], Any]] = {
            FieldKind.TEXT: lambda f: bench.server.gui.add_text(f.label, f.value, hint=f.hint),
            FieldKind.NUMBER: lambda f: bench.server.gui.add_number(
                f.label, float(f.value), min=0.0, step=_STEP, hint=f.hint
            ),
            FieldKind.VECTOR: lambda f: bench.server.gui.add_vector3(f.label, f.value, step=_STEP, hint=f.hint),
            FieldKind.CHOICE: lambda f: bench.server.gui.add_dropdown(
                f.label, f.choices, initial_value=f.value, hint=f.hint
            ),
            FieldKind.SWITCH: lambda f: bench.server.gui.add_checkbox(f.label, f.value, hint=f.hint),
        }
        self._form: tuple[object, ...] = ()
        self._folder: Any = None
        self._widgets: dict[str, Any] = {}
        self._fields: dict[str, Field] = {}
        self.refresh()

    def show(self, change: Change) -> None:
        """Show what an edit or another selection changed."""
        if change.kind is ChangeKind.SELECTION or change.changed or change.added or change.removed:
            self.refresh()

    def refresh(self) -> None:
        """Show what the scene has, also where a value was refused."""
        editor = self._bench.editor
        id_ = editor.selection[-1] if editor.selection else ROOT
        fields = fields_of(editor.scene, id_)
        title = title_of(editor.scene.get(id_)) if id_ else "scene"
        form = (id_, title, *((f.key, f.kind, f.choices) for f in fields))
        self._fields = {field.key: field for field in fields}
        if form != self._form:
            self._build(id_, title, fields)
            self._form = form
            return
        for field in fields:
            self._update(field)

    def _build(self, id_: int, title: str, fields: tuple[Field, ...]) -> None:
        if self._folder is not None:
            self._folder.remove()
        thing = self._bench.editor.scene.objects.get(id_)
        gui = self._bench.server.gui
        with self._container:
            kind = f"{thing.kind}: " if thing else ""
            self._folder = gui.add_folder(kind + title)
        with self._folder:
            self._widgets = {field.key: self._add(id_, field) for field in fields}
            if isinstance(thing, TrajectoryObject) and thing.agent is not None:
                slower = gui.add_button("Keep to limits", hint="Slow down until the agent's limits hold.")
                slower.on_click(self._bench.on(lambda _: self._bench.editor.do(Retime(id=id_))))

    def _add(self, id_: int, field: Field) -> Any:
        widget = self._makers[field.kind](field)
        widget.disabled = not field.enabled
        desk = self._bench.desk
        delay_s = 0.0 if field.kind in {FieldKind.CHOICE, FieldKind.SWITCH} else _TYPING_S

        async def typed(event: Any) -> None:
            if event.client_id is not None:
                value = event.target.value
                key = (id_, field.key)
                desk.later(key, lambda: self._set(id_, field.key, value), delay_s=delay_s)

        widget.on_update(typed)
        return widget

    def _set(self, id_: int, key: str, value: Any) -> None:
        """Do the edit of a field as it is by now; the object may be gone, or have no such field any more."""
        editor = self._bench.editor
        if id_ != ROOT and id_ not in editor.scene.objects:
            return
        field = next((f for f in fields_of(editor.scene, id_) if f.key == key), None)
        if field is not None and value != field.value:
            editor.do(field.command(value))

    def _update(self, field: Field) -> None:
        widget = self._widgets[field.key]
        if widget.disabled is field.enabled:
            widget.disabled = not field.enabled
        if widget.value != field.value and not self._bench.desk.waits((self._form[0], field.key)):
            widget.value = field.value
