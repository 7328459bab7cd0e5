"""Panels around the viewport: hierarchy, inspector, timeline and warnings.

Each panel shows a part of the editor's state in viser's widgets. Decisions are in `sfglab.spatial.scene`, `fields`
and `looks`.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.spatial.execution.client import trajectory_order
from sfglab.spatial.scene.editor import Change
from sfglab.spatial.scene.model import (
    ROOT,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    place_of,
)
from sfglab.units import NS_PER_S
from sfglab.view.planner.context import Context, Part
from sfglab.view.planner.fields import Field, fields_of
from sfglab.view.planner.looks import rows_of, title_of
from sfglab.view.planner.sending import Sending, usual_action

if TYPE_CHECKING:
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
# Buttons look like rows: flush left, and filled only if selected.
_ROWS_STYLE = """<style>
div:has(> * > .sfg-rows) > div { padding-bottom: 1px !important; }
div:has(> * > .sfg-rows) button { height: 1.9em !important; }
div:has(> * > .sfg-rows) button:not([style*="--button-bg"]) { background: transparent; color: inherit; }
div:has(> * > .sfg-rows) button:not([style*="--button-bg"]):hover { background: rgba(128,128,128,0.15); }
div:has(> * > .sfg-rows) .mantine-Button-inner { justify-content: flex-start; }
</style><span class="sfg-rows"></span>"""


class Hierarchy(Part):
    """The scene's tree of objects, one row each; a click selects an object."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context)
        self._container = container
        self._buttons: dict[int, Any] = {}
        with container:
            self._gui.add_html(_ROWS_STYLE, order=-1)
        self._draw()

    def show(self, change: Change) -> None:
        """Update the rows after objects were added, removed, moved, renamed or selected."""
        if change not in {Change.TIME, Change.SAVE}:
            self._draw()

    def _draw(self) -> None:
        rows = rows_of(self._editor.scene, self._editor.selection)
        for id_ in self._buttons.keys() - {thing.id for thing, _ in rows}:
            self._buttons.pop(id_).remove()
        for position, (thing, depth) in enumerate(rows):
            button = self._buttons.get(thing.id) or self._add(thing)
            assign(button, "label", _INDENT * depth + title_of(thing))
            assign(button, "color", "blue" if thing.id in self._editor.selection else None)
            assign(button, "order", position)

    def _add(self, thing: SceneObject) -> Any:
        icon = getattr(self._context.viser.Icon, _ICONS[thing.kind])
        with self._container:
            button = self._gui.add_button("", icon=icon)
        button.on_click(self._context.on(lambda _: self._clicked(thing.id)))
        self._buttons[thing.id] = button
        return button

    def _clicked(self, id_: int) -> None:
        if self._editor.selection == (id_,):
            self._editor.select()
        elif id_ in self._editor.scene.objects:
            self._editor.select(id_)


def assign(widget: Any, name: str, value: object) -> None:
    """Assign a property of a widget if it differs, because each assignment is a message to all browsers."""
    if getattr(widget, name) != value:
        setattr(widget, name, value)


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

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._id = ROOT
        self._form: object = None
        self._folder: Any = None
        self._widgets: dict[str, Any] = {}
        self._send_form: SendForm | None = None
        self.refresh()

    def show(self, change: Change) -> None:
        """Show the fields after an edit or another selection."""
        if change not in {Change.TIME, Change.SAVE}:
            self.refresh()

    def refresh(self) -> None:
        """Show the values of the scene again, which also resets a refused value."""
        scene, selection = self._editor.scene, self._editor.selection
        self._id = selection[-1] if selection else ROOT
        thing = scene.objects.get(self._id)
        title = f"{thing.kind}: {title_of(thing)}" if thing else "scene"
        action = usual_action(scene, self._id) if isinstance(thing, TrajectoryObject) else None
        fields = fields_of(scene, self._id)
        form = (title, action, *((f.key, f.choices) for f in fields))
        if form != self._form:
            self._form = form
            self._build(title, fields, sends=action is not None)
        for field in fields:
            widget = self._widgets[field.key]
            assign(widget, "disabled", not field.enabled)
            if not self._context.jobs.waits((self._id, field.key)):
                assign(widget, "value", field.value)

    def sent(self, id_: int) -> None:
        """Show the state of a trajectory that was sent."""
        if self._send_form is not None and self._id == id_:
            self._send_form.show()

    def _build(self, title: str, fields: tuple[Field, ...], *, sends: bool) -> None:
        if self._folder is not None:
            self._folder.remove()
        self._folder = self._gui.add_folder(title)
        with self._folder:
            self._widgets = {field.key: self._add(self._id, field) for field in fields}
            self._send_form = SendForm(self._context, self._id) if sends else None

    def _add(self, id_: int, field: Field) -> Any:
        label, value, hint, gui = field.label, field.value, field.hint, self._gui
        delay_s = _TYPING_S
        if field.choices:
            widget = gui.add_dropdown(label, field.choices, initial_value=value, hint=hint)
            delay_s = 0.0
        elif isinstance(value, str):
            widget = gui.add_text(label, value, hint=hint)
        elif isinstance(value, tuple):
            widget = gui.add_vector3(label, value, step=_STEP, hint=hint)
        else:
            widget = gui.add_number(label, value, min=0.0, step=_STEP, hint=hint)
        jobs = self._context.jobs

        async def typed(event: Any) -> None:
            if event.client_id is not None:
                new = event.target.value
                job = partial(self._set, id_, field.key, new)
                jobs.later((id_, field.key), job, delay_s=delay_s)

        widget.on_update(typed)
        return widget

    def _set(self, id_: int, key: str, value: Any) -> None:
        """Apply a new value of a field, unless its object is gone or no longer has this field."""
        if id_ != ROOT and id_ not in self._editor.scene.objects:
            return
        for field in fields_of(self._editor.scene, id_):
            if field.key == key and field.value != value:
                field.edit(self._editor, value)


_TICK_S = 0.05
_STEP_S = 0.01
_SHORTEST_S = 1.0


class Timeline(Part):
    """The slider and the play button."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._playing = False
        self._last_tick_s = 0.0
        self._slider = self._gui.add_slider("time (s)", 0.0, self._end_s(), _STEP_S, 0.0)
        self._button = self._gui.add_button("Play", icon=context.viser.Icon.PLAYER_PLAY)
        self._slider.on_update(
            context.on(self._editor.set_time, read=lambda e: e.target.value, key="time")
        )
        self._button.on_click(context.on(lambda _: self._toggle()))
        self._show_time()

    def show(self, change: Change) -> None:
        """Show another time, or another span of times."""
        if change not in {Change.TIME, Change.SELECTION}:
            assign(self._slider, "max", self._end_s())
        self._show_time()

    def _show_time(self) -> None:
        shown = min(max(self._editor.time_s, 0.0), self._slider.max)
        if abs(self._slider.value - shown) > _STEP_S / 2.0:
            self._slider.value = shown

    def _toggle(self) -> None:
        icon = self._context.viser.Icon
        self._playing = not self._playing
        self._button.label = "Pause" if self._playing else "Play"
        self._button.icon = icon.PLAYER_PAUSE if self._playing else icon.PLAYER_PLAY
        self._last_tick_s = time.monotonic()
        self._tick()

    def _tick(self) -> None:
        if not self._playing:
            return
        now_s = time.monotonic()
        time_s = self._editor.time_s + now_s - self._last_tick_s
        self._last_tick_s = now_s
        self._editor.set_time(time_s if time_s <= self._end_s() else 0.0)
        self._context.jobs.later("play", self._tick, delay_s=_TICK_S, settles=False)

    def _end_s(self) -> float:
        times_ns = [waypoint.time_ns for waypoint in self._editor.scene.all_of(WaypointObject)]
        return max([ns / NS_PER_S for ns in times_ns] + [_SHORTEST_S])


_MOST = 50
# The texts are sentences, so the buttons wrap their lines.
_WARNINGS_STYLE = """<style>
div:has(> * > .sfg-warnings) button { height: auto !important; padding: 0.35em 0.6em; }
div:has(> * > .sfg-warnings) .mantine-Button-label { white-space: normal; text-align: left; line-height: 1.3; }
div:has(> * > .sfg-warnings) .mantine-Button-inner { justify-content: flex-start; }
</style><span class="sfg-warnings"></span>"""


class Warnings(Part):
    """List of the plan's conflicts, one button each."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context)
        self._container = container
        self._buttons: list[Any] = []
        self._shown: tuple[Conflict, ...] = ()
        with container:
            self._gui.add_html(_WARNINGS_STYLE)
            self._head = self._gui.add_markdown("checking …")

    def show(self, change: Change) -> None:
        """Show that the list belongs to an older scene."""
        if change.is_of_scene:
            self._head.content = "checking …"

    def failed(self) -> None:
        """Show that the conflicts are unknown until the next check."""
        self._head.content = "the check failed"

    def found(self, conflicts: tuple[Conflict, ...]) -> None:
        """Show the number of conflicts, and a button for each of the first ones."""
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
        button = self._gui.add_button(conflict.text, color="red" if timed else "orange")
        button.on_click(self._context.on(lambda _: self._go(conflict)))
        return button

    def _go(self, conflict: Conflict) -> None:
        if conflict.time_s is not None:
            self._editor.set_time(conflict.time_s)
        self._editor.select(*(id_ for id_ in conflict.objects if id_ in self._editor.scene.objects))
