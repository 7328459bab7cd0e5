"""Panel of a notebook: the displays of a session as widgets, as in RViz.

The session checks all changes. A change that it refuses is reported below the row that adds displays. Widgets
come with the extra ``view``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, QoSProfile, Reliability
from sfglab.view.session import Change, Changed, Display, Session, available
from sfglab.view.widgets import attempt, button, widgets

if TYPE_CHECKING:
    from sfglab.view.visualizer import Parameter

Topics = Callable[[], Mapping[str, str]]


class Panel:
    """A list of displays with what can be tuned, and a row to add one. `widget` is what a cell shows.

    Raises:
        MissingExtraError: ipywidgets is not installed.
    """

    def __init__(self, session: Session, topics: Topics = dict) -> None:
        self._kit = widgets()
        self._session = session
        self._topics = topics
        self._rows: dict[str, Any] = {}
        self._states: dict[str, Any] = {}
        self._tuned: dict[str, Any] = {}
        self._said = self._kit.HTML()
        self._list = self._kit.VBox()
        kinds = self._kit.Dropdown(options=sorted(available().kinds), description="visualizer")
        topic = self._kit.Combobox(description="topic", options=sorted(self._topics()))
        add = button(
            "Add", lambda: attempt(lambda: self._add(kinds.value, topic.value), self._said)
        )
        self.widget = self._kit.VBox([self._kit.HBox([kinds, topic, add]), self._said, self._list])
        self._close = session.listen(self._changed)

    def parameter(self, id_: str, name: str) -> Any:
        """Return the widget of a display's parameter, which tunes it; InvalidValueError where there is none."""
        self._session.display(id_)
        tuned = self._tuned[id_]
        if name not in tuned:
            raise InvalidValueError("parameter", name, ", ".join(sorted(tuned)) or "none")
        return tuned[name]

    def close(self) -> None:
        """Stop following the session; again is harmless."""
        close, self._close = self._close, lambda: None
        close()

    def refresh(self) -> None:
        """Show the current counts of each display."""
        for display in self._session.displays:
            counts = display.slot.counts
            text = f"{counts.received} received, {counts.shown} shown, {counts.dropped} dropped"
            failed = f"; {display.errors} failed: {display.last_error}" if display.errors else ""
            self._states[display.id].value = text + failed

    def _add(self, kind: str, topic: str) -> None:
        """Add what the session offers for a topic, partners included; else the topic alone."""
        offers = self._session.offers({**self._topics()})
        bound = [o.topics for o in offers if o.kind == kind and topic in o.topics.values()]
        self._session.add(kind, bound[0] if bound else topic)

    def _changed(self, change: Change) -> None:
        if change.what is Changed.ADDED:
            self._rows[change.display.id] = self._row(change.display)
        elif change.what is Changed.REMOVED:
            for made in (self._rows, self._states, self._tuned):
                made.pop(change.display.id, None)
        self._list.children = tuple(self._rows.values())

    def _row(self, display: Display) -> Any:
        id_ = display.id
        on = self._kit.Checkbox(value=display.enabled, description=id_)
        self._follow(on, lambda value: self._session.enable(id_, enabled=value))
        rate = self._kit.FloatText(
            value=display.slot.budget.max_hz or 0.0, description="Hz (0: all)"
        )
        self._follow(rate, lambda value: self._session.limit(id_, value or None))
        remove = button("Remove", lambda: attempt(lambda: self._session.remove(id_), self._said))
        self._states[id_] = self._kit.Label()
        tuned = {p.name: self._parameter(display, p) for p in display.visualizer.parameters}
        self._tuned[id_] = tuned
        requests = [self._request(id_, given.role, qos) for given, _, qos in display.inputs]
        names = self._kit.Label(", ".join(display.visualizer.topics.values()))
        head = self._kit.HBox([on, names, rate, remove])
        return self._kit.VBox([head, *tuned.values(), *requests, self._states[id_]])

    def _parameter(self, display: Display, parameter: Parameter) -> Any:
        value = display.visualizer.settings[parameter.name]
        named = {"description": parameter.name, "value": value, "tooltip": parameter.help}
        if parameter.kind is bool:
            made = self._kit.Checkbox(**named)
        elif parameter.choices:
            made = self._kit.Dropdown(options=parameter.choices, **named)
        elif parameter.kind is str:
            made = self._kit.Text(continuous_update=False, **named)
        else:
            made = (self._kit.IntText if parameter.kind is int else self._kit.FloatText)(**named)
        self._follow(made, lambda new: self._session.tune(display.id, parameter.name, new))
        return made

    def _request(self, id_: str, role: str, qos: QoSProfile) -> Any:
        """Return the QoS of one input: whether lost messages are repaired, and whether the past is wanted."""
        pairs = product(Reliability, Durability)
        profiles = {
            f"{r.value}, {d.value}": replace(qos, reliability=r, durability=d) for r, d in pairs
        }
        label = f"{qos.reliability.value}, {qos.durability.value}"
        made = self._kit.Dropdown(options=tuple(profiles), value=label, description=f"QoS {role}")
        self._follow(made, lambda new: self._session.rewire(id_, qos={role: profiles[new]}))
        return made

    def _follow(self, widget: Any, apply: Callable[[Any], None]) -> None:
        """Pass a widget's new values on; one that is refused is taken back."""

        def changed(change: Any) -> None:
            if not attempt(lambda: apply(change["new"]), self._said):
                widget.unobserve(changed, "value")
                widget.value = change["old"]
                widget.observe(changed, "value")

        widget.observe(changed, "value")
