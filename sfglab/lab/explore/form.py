"""The form of a configuration: one widget a field, made from its type, bounds, documentation and unit.

A field with both bounds is a slider, on a logarithmic scale where its bounds say so; an enumeration or a
``Literal`` is a choice; a tuple of one bounded number is a slider as well, any other a text with commas. Fields
of a part of the configuration are called ``part.field``.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from html import escape
from operator import attrgetter
from typing import TYPE_CHECKING, Any, get_args, get_origin

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import Bounds, bounds_of, choices_of, field_docs, types_of
from sfglab.validation import read
from sfglab.view.widgets import refusal_html, widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

_HIDDEN = ("profile",)
_UNITS = {
    "hz": "Hz",
    "s": "s",
    "ms": "ms",
    "ns": "ns",
    "m": "m",
    "bytes": "B",
    "mm": "mm",
    "deg": "°",
}
_STEPS = 200


def unit_of(name: str, text: str) -> str:
    """Return a field's unit, from its documentation in brackets or from its name's end; empty: it has none."""
    named = re.search(r"\[([^\]]+)\]", text)
    return named[1] if named else _UNITS.get(name.rpartition("_")[2], "")


class Form:
    """Widgets that set a configuration. `widget` is what a cell shows.

    Named fields are shown first, the others in a fold below; `within` are narrower bounds of sliders, `texts` are
    fields' documentation where the class has none.

    Raises:
        MissingExtraError: ipywidgets is not installed.
        InvalidValueError: There is no such field, or it has a type that no widget holds.
    """

    def __init__(
        self,
        config: Any,
        first: Sequence[str],
        on_change: Callable[[], None] = lambda: None,
        within: Mapping[str, Bounds] | None = None,
        texts: Mapping[str, str] | None = None,
    ) -> None:
        kit = self._kit = widgets()
        self._begin, self.config, self._on_change = config, config, on_change
        self._said = kit.HTML()
        self.controls: dict[str, Any] = {}
        self._fields = _fields_of(type(config))
        self._within = within or {}
        self._texts = texts or {}
        rows = {name: self._row(name) for name in self._fields if name not in _HIDDEN}
        shown = {name: row for name, row in rows.items() if row is not None}
        for name in first:
            if name not in shown:
                raise InvalidValueError("field to turn", name, ", ".join(shown))
        others = [row for name, row in shown.items() if name not in first]
        fold = kit.Accordion(
            children=[kit.VBox(others)], titles=("Everything else",), selected_index=None
        )
        self.widget = kit.VBox(
            [*(shown[name] for name in first), self._said, *([fold] if others else [])]
        )

    def reset(self) -> None:
        """Set every field to what it was in the beginning."""
        for name, control in self.controls.items():
            control.value = _shown(attrgetter(name)(self._begin), control)

    def say(self, text: str) -> None:
        """Show a sentence below the widgets; empty: none."""
        self._said.value = refusal_html(text)

    def _row(self, name: str) -> Any | None:
        """Return a field's widget with its unit; None where no widget can hold it."""
        hint, bounds, text = self._fields[name]
        text = self._texts.get(name, text)
        control = self._control(hint, self._within.get(name, bounds), attrgetter(name)(self.config))
        if control is None:
            return None
        unit = unit_of(name, text)
        words = name.removesuffix(f"_{unit.lower().replace('µ', 'u')}") if unit else name
        control.description = words.replace("_", " ").replace(".", " ")
        control.tooltip = text
        control.style.description_width = "9em"
        control.layout.width = "26em"
        control.observe(lambda change: self._set(name, hint, change["new"]), "value")
        self.controls[name] = control
        said = self._kit.HTML(f'{escape(unit)} <small style="opacity:0.7">{escape(text)}</small>')
        return self._kit.HBox([control, said])

    def _control(self, hint: Any, bounds: Bounds | None, value: Any) -> Any | None:
        """Return a widget that holds a value of a type; None where none can."""
        kit, choices = self._kit, choices_of(hint)
        if get_origin(hint) is tuple:
            one = get_args(hint)[0]
            if len(value) == 1 and (bounds or choices_of(one)):
                return self._control(one, bounds, value[0])
            hint = str if one in (int, float, str) else None
        if hint is bool:
            return kit.Checkbox(value=value, indent=False)
        if choices:
            return kit.Dropdown(options=list(choices.items()), value=value)
        if hint in (int, float) and bounds and math.isfinite(bounds.high):
            return self._slider(hint, bounds, value)
        entry = {int: kit.IntText, float: kit.FloatText, str: kit.Text}.get(hint)
        return entry and entry(
            value=_as_text(value) if hint is str else value, continuous_update=False
        )

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
        try:
            config = _replaced(self.config, name, _read(hint, given))
        except (SfglabError, ValueError) as error:
            self.say(str(error))
            return
        self.say("")
        if config != self.config:
            self.config = config
            self._on_change()


_Field = tuple[Any, Bounds | None, str]  #: The type, the bounds and the text of a field.


def _fields_of(config_class: Any, part: str = "") -> dict[str, _Field]:
    """Return a configuration's fields, those of its parts too, by name."""
    found: dict[str, _Field] = {}
    docs, bounds = field_docs(config_class), bounds_of(config_class)
    for name, hint in types_of(config_class).items():
        if is_dataclass(hint):
            found |= _fields_of(hint, f"{part}{name}.")
        else:
            found[part + name] = hint, bounds.get(name), docs.get(name, "")
    return found


def _replaced(config: Any, name: str, value: Any) -> Any:
    """Return a configuration with another value of a field, which may be a part's, within its bounds."""
    head, _, rest = name.partition(".")
    if rest:
        return replace(config, **{head: _replaced(getattr(config, head), rest, value)})
    values = {field.name: getattr(config, field.name) for field in fields(config)}
    return read(type(config), values | {name: value})


def _as_text(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _shown(value: Any, control: Any) -> Any:
    """Return a field's value as its widget holds it."""
    if isinstance(value, tuple):
        return _as_text(value) if isinstance(control.value, str) else value[0]
    return value


def _read(hint: Any, given: Any) -> Any:
    """Return a widget's value as its field's, which need not be allowed there."""
    if get_origin(hint) is tuple:
        texts = given.split(",") if isinstance(given, str) else [given]
        parts = [part.strip() if isinstance(part, str) else part for part in texts]
        return tuple(_read(get_args(hint)[0], part) for part in parts if part != "")
    if isinstance(given, float):
        # A slider on a logarithmic scale has fractions, and returns a power of 10: 79.99999999999996.
        return round(given) if hint is int else float(f"{given:.9g}")
    if hint in (int, float) and isinstance(given, str):
        with suppress(ValueError):
            return hint(given)
    return given
