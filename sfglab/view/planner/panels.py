"""Panels around the viewport: hierarchy, inspector, timeline and warnings. Thin shells.

Each shows a part of the editor's state in viser's widgets. Decisions are in `sfglab.spatial.scene`, `fields` and
`looks`.
"""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.spatial.execution.client import trajectory_order
from sfglab.spatial.scene.editor import Change, ChangeKind
from sfglab.spatial.scene.model import (
    ROOT,
    SceneError,
    TrajectoryObject,
    WaypointObject,
    place_of,
)
from sfglab.units import NS_PER_S
from sfglab.view.planner.context import Context, Part
from sfglab.view.planner.fields import Field, FieldKind, fields_of
from sfglab.view.planner.looks import TreeRow, rows_of, title_of
from sfglab.view.planner.sending import Sending, usual_action

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.scene.conflicts import Conflict

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
_ROWS_STYLE = """<style>
div:has(> * > .sfg-rows) > div { padding-bottom: 1px !important; }
div:has(> * > .sfg-rows) button { height: 1.9em !important; }
div:has(> * > .sfg-rows) button:not([style*="--button-bg"]) { background: transparent; color: inherit; }
div:has(> * > .sfg-rows) button:not([style*="--button-bg"]):hover { background: rgba(128,128,128,0.15); }
div:has(> * > .sfg-rows) .mantine-Button-inner { justify-content: flex-start; }
</style><span class="sfg-rows"></span>"""


class Hierarchy(Part):
    """The tree of objects, as rows."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context, container)
        self._rows: dict[int, tuple[int, TreeRow]] = {}
        self._buttons: dict[int, Any] = {}
        with container:
            context.server.gui.add_html(_ROWS_STYLE, order=-1)
        self._draw()

    def show(self, change: Change) -> None:
        """Show rows that are new, removed, moved or renamed."""
        if change.kind not in {ChangeKind.TIME, ChangeKind.SAVE}:
            self._draw()

    def _draw(self) -> None:
        editor = self._context.editor
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
            icon = getattr(self._context.viser.Icon, _ICONS[row.kind])
            with self._container:
                button = self._context.server.gui.add_button(
                    label, icon=icon, color=colour, order=position
                )
            button.on_click(self._context.on(lambda _: self._clicked(row.id)))
            self._buttons[row.id] = button
            return
        for name, value in (("label", label), ("color", colour), ("order", position)):
            if getattr(button, name) != value:
                setattr(button, name, value)

    def _clicked(self, id_: int) -> None:
        editor = self._context.editor
        if id_ in editor.scene.objects:
            editor.select(*(() if editor.selection == (id_,) else (id_,)))


_TYPING_S = 0.5
_STEP = 0.05


class SendForm:
    """Widgets of the inspector for one trajectory, in the open container: action, send, cancel, feedback."""

    def __init__(self, context: Context, trajectory: int) -> None:
        self._context = context
        self._trajectory = trajectory
        gui, icon = context.server.gui, context.viser.Icon
        usual = usual_action(context.editor.scene, trajectory)
        with gui.add_folder("Send"):
            self._action = gui.add_text(
                "action", usual, hint="Action of type sfglab_interfaces/action/FollowTrajectory"
            )
            self._send = gui.add_button("Send", icon=icon.SEND)
            self._cancel = gui.add_button("Cancel", icon=icon.PLAYER_STOP)
            self._bar = gui.add_progress_bar(0.0)
            self._text = gui.add_markdown("")
        self._send.on_click(context.on(lambda _: self._clicked_send()))
        self._cancel.on_click(context.on(lambda _: context.sender.cancel(trajectory)))
        self.show()

    def show(self) -> None:
        """Show the state of the trajectory."""
        state = self._context.sender.states.get(self._trajectory, Sending())
        self._send.disabled = state.running
        self._cancel.disabled = not state.running
        self._bar.value = 100.0 * state.share
        self._text.content = state.text

    def _clicked_send(self) -> None:
        scene = self._context.editor.scene
        order = trajectory_order(scene, self._trajectory)
        if order is None:
            place = place_of(scene.get(self._trajectory))
            raise SceneError(place, None, "a trajectory with an agent and a waypoint, to be sent")
        self._context.sender.send(self._trajectory, order, self._action.value.strip())


class Inspector(Part):
    """The fields of the object that was selected last, or of the scene."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context, container)
        gui = context.server.gui
        self._makers: dict[FieldKind, Callable[[Field], Any]] = {
            FieldKind.TEXT: lambda f: gui.add_text(f.label, f.value, hint=f.hint),
            FieldKind.NUMBER: lambda f: gui.add_number(
                f.label, float(f.value), min=0.0, step=_STEP, hint=f.hint
            ),
            FieldKind.VECTOR: lambda f: gui.add_vector3(f.label, f.value, step=_STEP, hint=f.hint),
            FieldKind.CHOICE: lambda f: gui.add_dropdown(
                f.label, f.choices, initial_value=f.value, hint=f.hint
            ),
            FieldKind.SWITCH: lambda f: gui.add_checkbox(f.label, f.value, hint=f.hint),
        }
        self._form: tuple[object, ...] = ()
        self._folder: Any = None
        self._widgets: dict[str, Any] = {}
        self._fields: dict[str, Field] = {}
        self._send_form: SendForm | None = None
        self.refresh()

    def show(self, change: Change) -> None:
        """Show the fields after an edit or another selection."""
        if change.kind is ChangeKind.SELECTION or change.changed or change.added or change.removed:
            self.refresh()

    def refresh(self) -> None:
        """Show the values of the scene, also after a refused one."""
        editor = self._context.editor
        id_ = editor.selection[-1] if editor.selection else ROOT
        fields = fields_of(editor.scene, id_)
        title = title_of(editor.scene.get(id_)) if id_ else "scene"
        form = (id_, title, *((f.key, f.kind, f.choices) for f in fields))
        if isinstance(editor.scene.objects.get(id_), TrajectoryObject):
            form += (usual_action(editor.scene, id_),)
        self._fields = {field.key: field for field in fields}
        if form != self._form:
            self._build(id_, title, fields)
            self._form = form
            return
        for field in fields:
            widget = self._widgets[field.key]
            if widget.disabled is field.enabled:
                widget.disabled = not field.enabled
            if widget.value != field.value and not self._context.jobs.waits(
                (self._form[0], field.key)
            ):
                widget.value = field.value

    def sent(self, id_: int) -> None:
        """Show the state of a trajectory that was sent."""
        if self._send_form is not None and self._form[0] == id_:
            self._send_form.show()

    def _build(self, id_: int, title: str, fields: tuple[Field, ...]) -> None:
        if self._folder is not None:
            self._folder.remove()
        thing = self._context.editor.scene.objects.get(id_)
        gui = self._context.server.gui
        with self._container:
            self._folder = gui.add_folder((f"{thing.kind}: " if thing else "") + title)
        with self._folder:
            self._widgets = {field.key: self._add(id_, field) for field in fields}
            self._send_form = None
            if isinstance(thing, TrajectoryObject):
                self._send_form = SendForm(self._context, id_)

    def _add(self, id_: int, field: Field) -> Any:
        widget = self._makers[field.kind](field)
        widget.disabled = not field.enabled
        jobs = self._context.jobs
        delay_s = 0.0 if field.kind in {FieldKind.CHOICE, FieldKind.SWITCH} else _TYPING_S

        async def typed(event: Any) -> None:
            if event.client_id is not None:
                value = event.target.value
                jobs.later(
                    (id_, field.key), lambda: self._set(id_, field.key, value), delay_s=delay_s
                )

        widget.on_update(typed)
        return widget

    def _set(self, id_: int, key: str, value: Any) -> None:
        """Do the edit of a field; its object may be gone, or may no longer have this field."""
        editor = self._context.editor
        if id_ != ROOT and id_ not in editor.scene.objects:
            return
        field = next((f for f in fields_of(editor.scene, id_) if f.key == key), None)
        if field is not None and value != field.value:
            field.edit(editor, value)


_TICK_S = 0.05
_STEP_S = 0.01
_SHORTEST_S = 1.0


class Timeline(Part):
    """The slider and the play button."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context, container)
        self._stop: threading.Event | None = None
        self._ticker: threading.Thread | None = None
        gui = context.server.gui
        first, last = self._span()
        with container:
            shown = min(max(context.editor.time_s, first), last)
            self._slider = gui.add_slider("time (s)", first, last, _STEP_S, shown)
            self._button = gui.add_button("Play", icon=context.viser.Icon.PLAYER_PLAY)
        self._slider.on_update(
            context.on(context.editor.set_time, read=lambda e: e.target.value, key="time")
        )
        self._button.on_click(context.on(lambda _: self._toggle()))

    def show(self, change: Change) -> None:
        """Show another time, or another span of times."""
        if change.kind is not ChangeKind.TIME and change.kind is not ChangeKind.SELECTION:
            first, last = self._span()
            if (self._slider.min, self._slider.max) != (first, last):
                self._slider.min, self._slider.max = first, last
        shown = min(max(self._context.editor.time_s, self._slider.min), self._slider.max)
        if abs(self._slider.value - shown) > _STEP_S / 2.0:
            self._slider.value = shown

    def close(self) -> None:
        """Stop playing."""
        if self._stop is not None and self._ticker is not None:
            self._stop.set()
            self._ticker.join()
        self._stop = self._ticker = None

    def _toggle(self) -> None:
        playing = self._stop is not None
        self.close()
        icon = self._context.viser.Icon
        self._button.label = "Play" if playing else "Pause"
        self._button.icon = icon.PLAYER_PLAY if playing else icon.PLAYER_PAUSE
        if not playing:
            self._stop = threading.Event()
            self._ticker = threading.Thread(
                target=self._play, args=(self._stop,), name="planner-play", daemon=True
            )
            self._ticker.start()

    def _play(self, stop: threading.Event) -> None:
        last = time.monotonic()
        while not stop.wait(_TICK_S):
            now = time.monotonic()
            passed_s, last = now - last, now
            self._context.jobs.submit(partial(self._advance, passed_s), settle=False)

    def _advance(self, passed_s: float) -> None:
        first, end = self._span()
        time_s = self._context.editor.time_s + passed_s
        self._context.editor.set_time(time_s if time_s <= end else first)

    def _span(self) -> tuple[float, float]:
        scene = self._context.editor.scene
        last_ns = max((waypoint.time_ns for waypoint in scene.all_of(WaypointObject)), default=0)
        return (0.0, max(last_ns / NS_PER_S, _SHORTEST_S))


_MOST = 50
# Sentences, not captions: they wrap.
_WARNINGS_STYLE = """<style>
div:has(> * > .sfg-warnings) button { height: auto !important; padding: 0.35em 0.6em; }
div:has(> * > .sfg-warnings) .mantine-Button-label { white-space: normal; text-align: left; line-height: 1.3; }
div:has(> * > .sfg-warnings) .mantine-Button-inner { justify-content: flex-start; }
</style><span class="sfg-warnings"></span>"""


class Warnings(Part):
    """The conflicts, as buttons."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context, container)
        self._buttons: list[Any] = []
        self._shown: tuple[Conflict, ...] = ()
        with container:
            context.server.gui.add_html(_WARNINGS_STYLE)
            self._head = context.server.gui.add_markdown("checking …")

    def show(self, change: Change) -> None:
        """Show that the list is that of an older scene."""
        if change.changed or change.added or change.removed:
            self._head.content = "checking …"

    def failed(self) -> None:
        """Show that the scene was not checked."""
        self._head.content = "**not checked**: see the message"

    def found(self, conflicts: tuple[Conflict, ...]) -> None:
        """Show the conflicts of the scene."""
        many = f"{len(conflicts)} conflict" + ("s" if len(conflicts) != 1 else "")
        more = f", the first {_MOST} are listed" if len(conflicts) > _MOST else ""
        self._head.content = f"**{many}**{more}" if conflicts else "no conflicts"
        shown = conflicts[:_MOST]
        if shown == self._shown:
            return
        for button in self._buttons:
            button.remove()
        with self._container:
            self._buttons = [self._add(conflict) for conflict in shown]
        self._shown = shown

    def _add(self, conflict: Conflict) -> Any:
        timed = conflict.time_s is not None
        button = self._context.server.gui.add_button(
            conflict.text, color="red" if timed else "orange"
        )
        button.on_click(self._context.on(lambda _: self._go(conflict)))
        return button

    def _go(self, conflict: Conflict) -> None:
        editor = self._context.editor
        if conflict.time_s is not None:
            editor.set_time(conflict.time_s)
        editor.select(*(id_ for id_ in conflict.objects if id_ in editor.scene.objects))
