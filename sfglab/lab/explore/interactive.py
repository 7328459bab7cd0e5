"""An explorer of a function: sliders for its parameters, and a figure that follows them.

The function returns a `Picture`. It is computed in a thread of the kernel, because a process would double
the time from a slider's move to the figure. Vega draws in the page.
"""

from __future__ import annotations

import inspect
import logging
import threading
import time
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.experiment import Experiment
from sfglab.lab.explore.form import Form, explorer_box
from sfglab.lab.explore.press import Bundle, still_bundle
from sfglab.lab.explore.vega import LAST, figure_widget, ghosts_of, rows_of, still_png
from sfglab.lab.pictures import Picture
from sfglab.view.widgets import button, refusal_html, widgets

if TYPE_CHECKING:
    from collections.abc import Callable

_log = logging.getLogger(__name__)
_PAUSE_S = 0.12  #: Time for a newer setting before a simulation refines its plot, s.
_STILL_S = 60.0  #: Time that a cell waits for the complete plot, s.
_REST_S = 0.6  #: Time without a change after which a change begins a new setting, s.
_HINT = (
    "Dotted: the setting at the start. Faint: the previous setting. "
    "Press a point to print its values and the call that repeats them."
)


class Interactive:
    """An explorer of a function: a form with its parameters, and a figure that follows the form.

    A closed form returns one plot for a setting. A simulation returns an iterator of plots: coarse plots first, the
    complete plot last. The first plot is always shown, so that the figure follows a drag. After the first plot, the
    iterator is dropped as soon as there is a newer setting. The iterator may yield None in place of a plot, to be
    dropped there.

    Each setting has a thread. It first waits for the thread of the setting before, and ends at once if
    there is a newer setting by then. A new explorer of a function, as when its cell runs again, ends
    the computation of the former one.

    Args:
        function: Function that returns the plot of a setting, or an iterator of plots, coarse ones first.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    _newest: ClassVar[dict[str, Interactive]] = {}  # by the function's name

    def __init__(self, function: Callable[..., Any]) -> None:
        name = f"{function.__module__}.{function.__qualname__}"
        former = self._newest.pop(name, None)
        if former is not None:
            former.stop()
        self._function = function
        self.form = Form(function, self._ask)
        self._setting = self.form.default  #: Setting of the shown plot.
        computed = function()
        if not isinstance(computed, Picture):
            *_, computed = filter(None, computed)
        self.picture: Picture = computed  #: Shown plot.
        self._is_whole = True
        self._changed_at = time.monotonic()
        self._lock = threading.Lock()  # two threads send values to the page
        self._turn = threading.Lock()  # one setting is computed at a time
        self._changed = threading.Event()  # there is a newer setting than the one that is computed
        self._thread = threading.Thread()
        self._figure = figure_widget(self.picture)
        self._figure.on_msg(self._press)
        self._printed = widgets().HTML()
        reset = button("Reset", self.form.reset, "Every parameter as at the start")
        row = widgets().HBox([reset, widgets().HTML(_HINT)])
        self.widget = explorer_box([self.form.widget, row, self._figure, self._printed])
        self._newest[name] = self

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        """Return form and figure, and a still image with its sentence for pages without a kernel."""
        self.wait()
        png = still_png(self._figure.spec, self._figure.ghosts | self._figure.rows)
        data, metadata = still_bundle(self.widget, png, self.picture.said)
        return {**data, "text/plain": self.picture.said}, metadata

    def wait(self) -> None:
        """Wait until the complete plot of the newest setting is shown, or an error; a minute at most."""
        if self._figure.asked:
            self._thread.join(_STILL_S)

    def stop(self) -> None:
        """End the computation of a setting, if there is one; the next setting is computed again."""
        if self._thread.is_alive():
            with self._lock:
                self._figure.asked += 1
                self._figure.answer = {"of": self._figure.asked, "is": "whole"}
            self._changed.set()

    def code(self) -> str:
        """Return the Python call that repeats the shown plot."""
        changes = []
        for name, value in self._setting.items():
            if value != self.form.default[name]:
                changes.append(f"{name}={value!r}")
        name = self._function.__name__
        call = f"{name}({', '.join(changes)})"
        if inspect.isgeneratorfunction(self._function):
            call = f"[*{call}][-1]"
        return f"from {self._function.__module__} import {name}\n{call}"

    # Threads.

    def _ask(self) -> None:
        """Start the computation of the form's setting, which replaces waiting settings."""
        now = time.monotonic()
        rested = now - self._changed_at > _REST_S
        self._changed_at = now
        with self._lock:
            if rested and self._is_whole:
                self._figure.ghosts = self._figure.ghosts | ghosts_of(self.picture, LAST)
            self._figure.asked += 1
        self._changed.set()
        job = (self._figure.asked, self.form.values)
        self._thread = threading.Thread(target=self._run, args=job, name="explore", daemon=True)
        self._thread.start()

    def _run(self, request: int, setting: dict[str, Any]) -> None:
        """Show the plots of a setting, or the error, while the present plot is dimmed."""
        with self._turn:
            self._changed.clear()
            if request != self._figure.asked:
                return
            try:
                self._compute(request, setting)
            except Exception as error:  # noqa: BLE001  # the figure says what cannot be drawn
                reason = str(error)
                if not isinstance(error, SfglabError):
                    _log.exception("an explorer")
                    reason = f"it cannot be drawn: {error!r}"
                with self._lock:
                    self._figure.answer = {"of": request, "is": "refused", "why": reason}

    def _compute(self, request: int, setting: dict[str, Any]) -> None:
        computed = self._function(**setting)
        if isinstance(computed, Picture):
            self._show(request, setting, computed, "whole")
            return
        last = None
        for picture in computed:
            if picture is not None:
                last = picture
                self._show(request, setting, picture, "coarse")
                self._changed.wait(_PAUSE_S)
            if last is not None and self._changed.is_set():
                return
        assert last is not None, "a simulation has a picture"
        self._show(request, setting, last, "whole")

    def _show(self, request: int, setting: dict[str, Any], picture: Picture, state: str) -> None:
        """Send a plot to the page."""
        with self._lock, self._figure.hold_sync():
            self._setting = setting
            self.picture = picture
            self._is_whole = state == "whole"
            self._figure.said = picture.said
            self._figure.rows = rows_of(picture)
            self._figure.answer = {"of": request, "is": state}

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
        raise InvalidValueError("experiment", what.name, "an experiment that declares an explorer")
    [function] = what.explorers.values()
    return Interactive(function)
