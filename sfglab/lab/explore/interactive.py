"""An explorer of a function: sliders for its parameters, and a figure that follows them.

The function returns a `Picture`. A `Follower` computes in threads of the kernel, because a process
would double the time from a slider's move to the figure. Vega draws in the page.
"""

from __future__ import annotations

import inspect
import threading
import time
from html import escape
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.experiment import Experiment
from sfglab.lab.explore.follower import Follower
from sfglab.lab.explore.form import Form
from sfglab.lab.explore.press import Bundle, still_bundle
from sfglab.lab.explore.vega import LAST, figure_widget, ghosts_of, rows_of, still_png
from sfglab.lab.pictures import Picture
from sfglab.view.widgets import button, refusal_html, widgets

if TYPE_CHECKING:
    from collections.abc import Callable

_STILL_S = 60.0  #: Time that a cell waits for the whole picture, s.
_REST_S = 0.6  #: Time without a change after which a change begins a new setting, s.
_HINT = (
    "Dotted: the setting at the start. Faint: the previous setting. "
    "Press a point to print its values and the call that repeats them."
)


class Interactive:
    """What `explore` shows of a function; it has a form and a figure that follows.

    Args:
        function: Returns the picture of a setting, or an iterator of pictures, coarse ones first.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self.form = Form(function, self._ask)
        self._setting = self.form.default  #: Setting of the picture that is shown.
        computed = function()
        self.picture: Picture  #: The picture that is shown.
        *_, self.picture = [computed] if isinstance(computed, Picture) else filter(None, computed)
        self._is_whole = True
        self._changed_at = time.monotonic()
        self._lock = threading.Lock()  # two threads send values to the page
        self._figure = figure_widget(self.picture)
        self._figure.on_msg(self._press)
        self._printed = widgets().HTML()
        self._follower = Follower(function, self._show, self._refuse)
        reset = button("Reset", self.form.reset, "Every parameter as at the start")
        row = widgets().HBox([reset, widgets().HTML(_HINT)])
        self.widget = widgets().VBox([self.form.widget, row, self._figure, self._printed])

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        """Show form and figure, and a still with its sentence where no kernel runs."""
        self.wait(_STILL_S)
        png = still_png(self._figure.spec, self._figure.ghosts | self._figure.rows)
        data, metadata = still_bundle(self.widget, png, self.picture.said)
        return {**data, "text/plain": self.picture.said}, metadata

    def wait(self, timeout_s: float) -> bool:
        """Wait until the whole picture of the newest setting is shown, or refused; return whether in time."""
        return self._follower.wait(timeout_s)

    def code(self) -> str:
        """Return the call that repeats the picture that is shown."""
        changes = []
        for name, value in self._setting.items():
            if value != self.form.default[name]:
                changes.append(f"{name}={value!r}")
        name = self._function.__name__
        call = f"{name}({', '.join(changes)})"
        if inspect.isgeneratorfunction(self._function):
            call = f"[*{call}][-1]"
        return f"from {self._function.__module__} import {name}\n{call}"

    def _ask(self) -> None:
        """Request the picture of the form's setting."""
        now = time.monotonic()
        rested = now - self._changed_at > _REST_S
        self._changed_at = now
        with self._lock:
            if rested and self._is_whole:
                self._figure.ghosts = self._figure.ghosts | ghosts_of(self.picture, LAST)
            self._figure.asked = self._follower.ask(self.form.values)

    # The follower's side.

    def _show(self, request: int, setting: dict[str, Any], picture: Picture, final: bool) -> None:  # noqa: FBT001
        """Send a picture to the page."""
        with self._lock, self._figure.hold_sync():
            self._setting = setting
            self.picture = picture
            self._is_whole = final
            self._figure.said = picture.said
            self._figure.rows = rows_of(picture)
            self._figure.answer = {"of": request, "is": "whole" if final else "coarse"}

    def _refuse(self, request: int, reason: str) -> None:
        """Show why a setting has no picture; what is shown is dimmed."""
        with self._lock:
            self._figure.answer = {"of": request, "is": "refused", "why": reason}

    # The page's side.

    def _press(self, _widget: object, point: dict[str, Any], _buffers: object) -> None:
        """Print the values of a panel at a position, and the call that repeats them."""
        panel = self.picture.panels[point["place"]].title
        x = point["x"]
        try:
            values = self.picture.at(panel, x).to_string(index=False)
        except SfglabError as error:  # the picture has changed since
            self._printed.value = refusal_html(str(error))
            return
        text = f"{values}\n\n{self.code()}.at({panel!r}, {x!r})"
        self._printed.value = f"<pre>{escape(text)}</pre>"


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
