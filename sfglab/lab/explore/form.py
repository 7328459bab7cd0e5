"""Form of a function: one widget per parameter, made from its type, default value and documentation.

A number has a slider over its bounds, on a logarithmic scale where its bounds say so. A truth value has a
box to tick, and a ``Literal`` has a list.
"""

from __future__ import annotations

import inspect
import math
import re
from html import escape
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sfglab.fields import Bounds

_STEPS = 200
_UNIT = re.compile(r" ?\[([^\]]+)\]")
_STYLE = """<style>
.sfglab-explore { container-type: inline-size; max-width: 1100px }
.sfglab-explore select { font-family: inherit }
.sfglab-explore .widget-html-content { line-height: 1.4; align-self: center }
@container (max-width: 600px) {
  .sfglab-explore .widget-hbox, .sfglab-explore .widget-inline-hbox { flex-wrap: wrap; height: auto }
  .sfglab-explore .widget-hbox > :not(button) { width: calc(100% - 4px) !important }
  .sfglab-explore .widget-inline-hbox > .widget-label { width: 100% !important; text-align: left }
}
</style>"""
_ARGUMENT = re.compile(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", re.MULTILINE)


def default_values(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the default values of a function's parameters."""
    parameters = inspect.signature(function).parameters.values()
    return {parameter.name: parameter.default for parameter in parameters}


def argument_texts(function: Callable[..., Any]) -> dict[str, str]:
    """Return the texts of a function's parameters, from the section ``Args`` of its documentation."""
    section = (inspect.getdoc(function) or "").partition("Args:\n")[2].partition("\n\n")[0]
    return {name: " ".join(text.split()) for name, text in _ARGUMENT.findall(section)}


def explorer_box(children: Sequence[Any]) -> Any:
    """Return widgets below each other, as wide as people read; a narrow page has them without a row."""
    kit = widgets()
    box = kit.VBox([kit.HTML(_STYLE, layout={"display": "none"}), *children])
    return box.add_class("sfglab-explore")


class Form:
    """Widgets for the parameters of a function; a cell shows `widget`.

    Args:
        function: Its parameters are truth values, ``Literal``, or numbers with `Bounds`. Their units are in
            brackets in the section ``Args`` of its documentation.
        on_change: Called after each change.

    Raises:
        MissingExtraError: ipywidgets is not installed.
    """

    def __init__(self, function: Callable[..., Any], on_change: Callable[[], None]) -> None:
        self.default = default_values(function)  #: Values at the start.
        self.values = self.default.copy()  #: Present values.
        self._on_change = on_change
        self.controls: dict[str, Any] = {}
        hints = get_type_hints(function, include_extras=True)
        texts = argument_texts(function)
        rows = [self._row(name, hints[name], texts.get(name, "")) for name in self.default]
        self.widget = widgets().VBox(rows)

    def reset(self) -> None:
        """Set every parameter to its value at the start."""
        for name, control in self.controls.items():
            control.value = self.default[name]

    def _row(self, name: str, hint: Any, text: str) -> Any:
        """Return a parameter's widget with its unit and text."""
        control = _control(hint, self.default[name])
        found = _UNIT.search(text)
        unit = found[1] if found else ""
        suffix = f"_{unit.lower().replace('µ', 'u').replace('%', 'percent')}"
        control.description = name.removesuffix(suffix).replace("_", " ")
        control.tooltip = text
        control.style.description_width = "9em"
        control.layout.width = "26em"
        control.observe(lambda change: self._set(name, hint, change["new"]), "value")
        self.controls[name] = control
        words = escape(_UNIT.sub("", text))
        about = widgets().HTML(f'{escape(unit)} <small style="opacity:0.7">{words}</small>')
        return widgets().HBox([control, about])

    def _set(self, name: str, hint: Any, given: Any) -> None:
        if isinstance(given, float):
            # A slider on a logarithmic scale has fractions, and returns a power of 10: 79.99999999999996.
            given = round(given) if int in get_args(hint) else float(f"{given:.9g}")
        if given != self.values[name]:
            self.values = {**self.values, name: given}
            self._on_change()


def _control(hint: Any, value: Any) -> Any:
    """Return a widget that holds a value of a type."""
    kit = widgets()
    if hint is bool:
        return kit.Checkbox(value=value, indent=False)
    choices = get_args(hint)
    if choices[0] not in (int, float):
        return kit.Dropdown(options=choices, value=value)
    number, bounds = choices
    return _slider(number, bounds, value)


def _slider(number: type, bounds: Bounds, value: float) -> Any:
    kit = widgets()
    shown = ".0f" if number is int else ".3g"
    if bounds.log:
        low, high = math.log10(bounds.low), math.log10(bounds.high)
        step = (high - low) / _STEPS
        below = math.log10(value) - low
        if below > 0:  # A page sets a value to the nearest step, so the start must be one.
            step = below / max(1, round(below / step))
        return kit.FloatLogSlider(value=value, min=low, max=high, step=step, readout_format=shown)
    if number is int:
        return kit.IntSlider(value=value, min=bounds.low, max=bounds.high)
    # A round step keeps round values.
    step = 10.0 ** math.floor(math.log10((bounds.high - bounds.low) / _STEPS))
    return kit.FloatSlider(
        value=value, min=bounds.low, max=bounds.high, step=step, readout_format=shown
    )
