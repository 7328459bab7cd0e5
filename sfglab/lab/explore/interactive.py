"""An explorer of a function: sliders for its parameters, and a figure that follows them.

The function returns a `Picture`. A `Follower` computes in a thread of the kernel, because a process
would double the time from a slider's move to the figure. Vega draws in the page.
"""

from __future__ import annotations

import inspect
import re
import threading
import time
from dataclasses import make_dataclass
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar, get_type_hints

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.experiment import Experiment
from sfglab.lab.explore.follower import Follower
from sfglab.lab.explore.form import Form
from sfglab.lab.explore.press import Bundle, still_bundle
from sfglab.lab.explore.vega import (
    LAST,
    figure_widget,
    ghosts_of,
    rows_of,
    still_png,
)
from sfglab.lab.pictures import Picture
from sfglab.view.widgets import button, refusal_html, widgets

if TYPE_CHECKING:
    from collections.abc import Callable

_STILL_S = 60.0  #: Time that a cell waits for the whole picture, s.
_REST_S = 0.6  #: Time without a change after which a change begins a new setting, s.
_ARGUMENT = re.compile(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", re.MULTILINE)
_HINT = (
    "Dotted: the setting at the start. Faint: the previous setting. "
    "Press a point to print its values and the call that repeats them."
)


def setting_of(function: Callable[..., Any]) -> Any:
    """Return the default values of a function's parameters, as a dataclass made of them."""
    hints = get_type_hints(function, include_extras=True)
    made = []
    for name, parameter in inspect.signature(function).parameters.items():
        made.append((name, hints[name], parameter.default))
    return make_dataclass("Setting", made, frozen=True)()


def argument_texts(function: Callable[..., Any]) -> dict[str, str]:
    """Return the texts of a function's parameters, from the section ``Args`` of its documentation."""
    section = (inspect.getdoc(function) or "").partition("Args:\n")[2].partition("\n\n")[0]
    return {name: " ".join(text.split()) for name, text in _ARGUMENT.findall(section)}


class Interactive:
    """What `explore` shows of a function; it has a form and a figure that follows.

    Of each function one explorer is open: a cell that runs again closes the one before.

    Args:
        function: Returns the picture of a setting, or an iterator of pictures, coarse ones first.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    _open: ClassVar[dict[str, Interactive]] = {}

    def __init__(self, function: Callable[..., Any]) -> None:
        name = f"{function.__module__}.{function.__qualname__}"
        if (former := self._open.pop(name, None)) is not None:
            former.close()
        self._function = function
        self._default = self._setting = setting_of(function)
        texts = argument_texts(function)
        self.form = Form(self._default, self._ask, texts)
        self.picture = self._whole(self._default)  #: The picture that is shown.
        self._is_whole = True
        self._changed_at = time.monotonic()
        self._lock = threading.Lock()  # two threads send values to the page
        self._figure = figure_widget(self.picture)
        self._figure.on_msg(self._press)
        self._printed = widgets().HTML()
        self._follower = Follower(self._compute, self._show, self._refuse)
        reset = button("Reset", self.form.reset, "Every parameter as at the start")
        row = widgets().HBox([reset, widgets().HTML(escape(_HINT))])
        self.widget = widgets().VBox([self.form.widget, row, self._figure, self._printed])
        self._open[name] = self

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        """Show form and figure, and a still with its sentence where no kernel runs."""
        self.wait()
        png = still_png(self._figure.spec, self._figure.ghosts | self._figure.rows)
        data, metadata = still_bundle(self.widget, png, self.picture.said)
        return {**data, "text/plain": self.picture.said}, metadata

    def wait(self, timeout_s: float = _STILL_S) -> bool:
        """Wait until the whole picture of the newest setting is shown, or refused; return whether in time."""
        return self._follower.wait(timeout_s)

    def code(self) -> str:
        """Return the call that repeats the picture that is shown."""
        default = vars(self._default)
        values = vars(self._setting).items()
        changes = [f"{key}={value!r}" for key, value in values if value != default[key]]
        name = self._function.__name__
        call = f"{name}({', '.join(changes)})"
        if inspect.isgeneratorfunction(self._function):
            call = f"[*{call}][-1]"
        return f"from {self._function.__module__} import {name}\n{call}"

    def close(self) -> None:
        """End the thread. Harmless when repeated."""
        self._follower.close()

    # The form's side.

    def _compute(self, setting: Any) -> Any:
        return self._function(**vars(setting))

    def _whole(self, setting: Any) -> Picture:
        computed = self._compute(setting)
        if isinstance(computed, Picture):
            return computed
        whole: Picture
        *_, whole = filter(None, computed)
        return whole

    def _ask(self) -> None:
        now = time.monotonic()
        rested = now - self._changed_at > _REST_S
        self._changed_at = now
        with self._lock:
            if rested and self._is_whole:
                self._figure.ghosts = self._figure.ghosts | ghosts_of(self.picture, LAST)
            self._figure.asked = self._follower.ask(self.form.config)

    # The follower's side.

    def _show(self, request: int, setting: Any, picture: Picture, final: bool) -> None:  # noqa: FBT001
        """Send a picture to the page."""
        with self._lock, self._figure.hold_sync():
            self._setting = setting
            self.picture = picture
            self._is_whole = final
            self._figure.said = picture.said
            self._figure.rows = rows_of(picture)
            self._figure.answer = {"of": request, "is": "whole" if final else "coarse"}

    def _refuse(self, request: int, reason: str) -> None:
        """Show why the newest setting has no picture; what is shown is dimmed."""
        with self._lock:
            if request == self._figure.asked:
                self._figure.answer = {"of": request, "is": "refused"}
                self.form.say(reason)

    # The page's side.

    def _press(self, _widget: object, point: dict[str, Any], _buffers: object) -> None:
        try:
            panel = self.picture.panels[point["place"]]
            text = self.print_values(panel.title, point["x"])
        except SfglabError as error:
            self._printed.value = refusal_html(str(error))
            return
        self._printed.value = f"<pre>{escape(text)}</pre>"

    def print_values(self, panel: str, x: float) -> str:
        """Return the values of a panel at a position, and the call that repeats them."""
        values = self.picture.at(panel, x).to_string(index=False)
        return f"{values}\n\n{self.code()}.at({panel!r}, {x!r})"


def explore(what: Experiment[Any] | Callable[..., Any]) -> Interactive:
    """Show sliders, and a figure that follows them.

        explore(transfer.exp)

    Args:
        what: Experiment, or a function that returns a `Picture` (see `Experiment.explorer`).

    Raises:
        InvalidValueError: The experiment has no explorer.
        MissingExtraError: The extra ``view`` is not installed.
    """
    if not isinstance(what, Experiment):
        return Interactive(what)
    if not what.explorers:
        raise InvalidValueError("experiment", what.name, "one with an explorer")
    [function] = what.explorers.values()
    return Interactive(function)
