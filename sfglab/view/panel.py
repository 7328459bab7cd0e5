"""Panel of a notebook: the displays of a session as widgets, as in RViz.

The session checks all changes. A change that it refuses is reported below the row that adds displays. Widgets
come with the extra ``view``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Any

from sfglab.qos import Durability, QoSProfile, Reliability
from sfglab.view.widgets import attempt, button, refusal_html, widgets

if TYPE_CHECKING:
    from sfglab.view.session import Display, Session
    from sfglab.view.visualizer import Parameter

Topics = Callable[[], Mapping[str, str]]


class Panel:
    """A list of displays with their parameters, and a row that adds a display. A cell shows `widget`.

    Raises:
        MissingExtraError: ipywidgets is not installed.
    """

    def __init__(self, session: Session, topics: Topics = dict) -> None:
        kit = self._kit = widgets()
        self._session = session
        self._topics = topics
        self._rows: dict[str, Any] = {}
        self._kind = kit.Dropdown(options=sorted(session.kinds), description="visualizer")
        self._topic = kit.Combobox(description="topic", options=sorted(topics()))
        add = button("Add", lambda: attempt(self._add, self._said))
        self._said = kit.HTML(refusal_html("; ".join(session.problems)))
        self._list = kit.VBox()
        head = kit.HBox([self._kind, self._topic, add])
        self.widget = kit.VBox([head, self._said, self._list])
        #: Ends the notifications by the session; further calls have no effect.
        self.close = session.listen(self._arrange)

    def refresh(self) -> None:
        """Show the current counts of each display, and offer the topics that there are now."""
        self._topic.options = sorted(self._topics())
        for display in self._session.displays:
            self._rows[display.id].children[-1].value = display.counts

    def _add(self) -> None:
        """Add the display that the session offers for a topic with its related topics, or for the topic alone."""
        kind, topic = self._kind.value, self._topic.value
        for offer in self._session.offers(self._topics()):
            if offer.kind == kind and topic in offer.topics.values():
                self._session.add(kind, offer.topics)
                return
        self._session.add(kind, topic)

    def _arrange(self) -> None:
        """Show one row per display."""
        rows = {}
        for display in self._session.displays:
            rows[display.id] = self._rows.get(display.id) or self._row(display)
        self._rows = rows
        self._list.children = tuple(rows.values())

    def _row(self, display: Display) -> Any:
        kit, session, id_ = self._kit, self._session, display.id
        on = kit.Checkbox(value=display.enabled, description=id_)
        self._follow(on, lambda value: session.enable(id_, enabled=value))
        rate = kit.FloatText(value=display.slot.max_hz or 0.0, description="Hz (0: all)")
        self._follow(rate, lambda value: session.limit(id_, value or None))
        remove = button("Remove", lambda: attempt(lambda: session.remove(id_), self._said))
        names = kit.Label(", ".join(display.topics.values()))
        rows = [kit.HBox([on, names, rate, remove])]
        rows += [self._parameter(display, each) for each in display.visualizer.parameters]
        rows += [self._request(id_, given.role, qos) for given, _, qos in display.inputs]
        return kit.VBox([*rows, kit.Label(display.counts)])

    def _parameter(self, display: Display, parameter: Parameter) -> Any:
        kit, name = self._kit, parameter.name
        kinds = {bool: kit.Checkbox, int: kit.IntText, float: kit.FloatText, str: kit.Text}
        more = {"continuous_update": False} if parameter.kind is str else {}
        made = kinds[parameter.kind](
            description=name,
            value=display.visualizer.settings[name],
            tooltip=parameter.help,
            **more,
        )
        self._follow(made, lambda new: self._session.tune(display.id, name, new))
        return made

    def _request(self, id_: str, role: str, qos: QoSProfile) -> Any:
        """Return the drop-down list for the QoS of one input: reliability and durability."""
        profiles = {}
        for reliability, durability in product(Reliability, Durability):
            profile = replace(qos, reliability=reliability, durability=durability)
            profiles[f"{reliability.value}, {durability.value}"] = profile
        chosen = f"{qos.reliability.value}, {qos.durability.value}"
        made = self._kit.Dropdown(options=list(profiles), value=chosen, description=f"QoS {role}")
        self._follow(made, lambda new: self._session.request(id_, role, profiles[new]))
        return made

    def _follow(self, widget: Any, apply: Callable[[Any], None]) -> None:
        """Apply new values of a widget; a refused value is reset in the widget."""

        def changed(change: Any) -> None:
            if not attempt(lambda: apply(change["new"]), self._said):
                widget.unobserve(changed, "value")
                widget.value = change["old"]
                widget.observe(changed, "value")

        widget.observe(changed, "value")
