"""Form of a setting: one widget per field, made from its type, bounds, documentation and unit.

A field with both bounds has a slider, on a logarithmic scale where its bounds say so. An enumeration or a
``Literal`` has a list, and any other field an entry.
"""

from __future__ import annotations

import math
import re
from dataclasses import fields
from html import escape
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fields import bounds_of, choices_of, field_docs, types_of
from sfglab.validation import read
from sfglab.view.widgets import refusal_html, widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from sfglab.fields import Bounds

_STEPS = 200


def unit_of(text: str) -> str:
    """Return the unit that a field's documentation has in brackets; empty: none."""
    named = re.search(r"\[([^\]]+)\]", text)
    return named[1] if named else ""


class Form:
    """Widgets that change a setting, a dataclass. `widget` is what a cell shows.

    Args:
        setting: Values at the start.
        on_change: Called after each change.
        texts: Documentation of fields, if the class has none.

    Raises:
        MissingExtraError: ipywidgets is not installed.
    """

    def __init__(
        self,
        setting: Any,
        on_change: Callable[[], None],
        texts: Mapping[str, str] | None = None,
    ) -> None:
        kit = self._kit = widgets()
        self._begin, self.config, self._on_change = setting, setting, on_change
        self._said = kit.HTML()
        self.controls: dict[str, Any] = {}
        of: Any = type(setting)
        docs = {**field_docs(of), **(texts or {})}
        bounds = bounds_of(of)
        rows = []
        for name, hint in types_of(of).items():
            rows.append(self._row(name, hint, bounds.get(name), docs.get(name, "")))
        self.widget = kit.VBox([*rows, self._said])

    def reset(self) -> None:
        """Set every field to its value at the start."""
        for name, control in self.controls.items():
            control.value = getattr(self._begin, name)

    def say(self, text: str) -> None:
        """Show a sentence below the widgets; empty: none."""
        self._said.value = refusal_html(text)

    def _row(self, name: str, hint: Any, bounds: Bounds | None, text: str) -> Any:
        """Return a field's widget with its unit and text."""
        control = self._control(hint, bounds, getattr(self.config, name))
        unit = unit_of(text)
        words = name.removesuffix(f"_{unit.lower().replace('µ', 'u')}") if unit else name
        control.description = words.replace("_", " ")
        control.tooltip = text
        control.style.description_width = "9em"
        control.layout.width = "26em"
        control.observe(lambda change: self._set(name, hint, change["new"]), "value")
        self.controls[name] = control
        said = self._kit.HTML(f'{escape(unit)} <small style="opacity:0.7">{escape(text)}</small>')
        return self._kit.HBox([control, said])

    def _control(self, hint: Any, bounds: Bounds | None, value: Any) -> Any:
        """Return a widget that holds a value of a type."""
        kit, choices = self._kit, choices_of(hint)
        if hint is bool:
            return kit.Checkbox(value=value, indent=False)
        if choices:
            return kit.Dropdown(options=list(choices.items()), value=value)
        if bounds and math.isfinite(bounds.high):
            return self._slider(hint, bounds, value)
        entries = {int: kit.IntText, float: kit.FloatText, str: kit.Text}
        return entries[hint](value=value, continuous_update=False)

    def _slider(self, hint: Any, bounds: Bounds, value: float) -> Any:
        shown = ".0f" if hint is int else ".3g"
        if bounds.log:
            low, high = math.log10(bounds.low), math.log10(bounds.high)
            step = (high - low) / _STEPS
            below = math.log10(value) - low
            if below > 0:  # A page sets a value to the nearest step, so the start must be one.
                step = below / max(1, round(below / step))
            return self._kit.FloatLogSlider(
                value=value, min=low, max=high, step=step, readout_format=shown
            )
        if hint is int:
            return self._kit.IntSlider(value=value, min=bounds.low, max=bounds.high)
        # A round step keeps round values.
        step = 10.0 ** math.floor(math.log10((bounds.high - bounds.low) / _STEPS))
        return self._kit.FloatSlider(
            value=value, min=bounds.low, max=bounds.high, step=step, readout_format=shown
        )

    def _set(self, name: str, hint: Any, given: Any) -> None:
        if hint in (int, float):
            # A slider on a logarithmic scale has fractions, and returns a power of 10: 79.99999999999996.
            given = round(given) if hint is int else float(f"{given:.9g}")
        values = {field.name: getattr(self.config, field.name) for field in fields(self.config)}
        try:
            config = read(type(self.config), values | {name: given})
        except SfglabError as error:
            self.say(str(error))
            return
        self.say("")
        if config != self.config:
            self.config = config
            self._on_change()
