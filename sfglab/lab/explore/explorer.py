"""An explorer: a form, the figure that follows it, the one before kept faint, and the reference run's.

Pictures are drawn by a worker process; requests carry numbers, and only the newest one's pictures are shown.
What takes long runs on a button, in a process of its own, with progress and a stop.
"""

from __future__ import annotations

import base64
import json
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from sfglab.component import Report, argument_of
from sfglab.errors import InvalidValueError
from sfglab.fields import to_json
from sfglab.lab.experiment import Experiment
from sfglab.lab.explore.form import Form
from sfglab.lab.explore.interactive import Interactive
from sfglab.lab.explore.press import still_bundle
from sfglab.lab.paths import find_project
from sfglab.lab.runs import new_log, unfinished_of
from sfglab.view.widgets import button, refusal_html, widgets

if TYPE_CHECKING:
    from collections.abc import Callable

#: How long a cell waits for the first picture, s: an empty cache compiles for 13.
_FIRST_PICTURE_S = 90.0
_FAINT = "sfglab-before"
_STYLE = f"<style>.{_FAINT} {{ opacity: 0.35 }}</style>"


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What the process is for."""

    experiment: str  #: The experiment's name.
    profile: str = ""  #: Of the run that it makes; empty: it draws.
    log: str = ""  #: Path of that run's log.
    settings: dict[str, Any] = field(default_factory=dict)  #: Fields of that run, as JSON has them.
    #: Tables of sweeps and names of parts that it makes; None: all.
    only: tuple[str, ...] | None = None


class Worker:
    """A worker process without a loop; a thread of its own is told every report, ``{"is": "ended"}`` last."""

    def __init__(self, task: Task, on_report: Callable[[Report], None]) -> None:
        argv = [sys.executable, "-m", "sfglab.lab.workers.preview", argument_of(task)]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(argv, stdin=pipe, stdout=pipe, text=True)
        threading.Thread(
            target=self._listen, args=(on_report,), name="explore", daemon=True
        ).start()

    def _listen(self, on_report: Callable[[Report], None]) -> None:
        with self._process as process:
            for line in process.stdout or ():
                on_report(json.loads(line))
        on_report({"is": "ended"})

    def order(self, **values: Any) -> None:
        """Give an order; a process that is gone does not mind."""
        with suppress(OSError, ValueError):
            print(json.dumps(values), file=self._process.stdin, flush=True)

    def close(self) -> None:
        """End it; what it started ends with it. Harmless when repeated."""
        if self._process.stdin:
            with suppress(OSError):
                self._process.stdin.close()


class Explorer:
    """What `explore` shows, which has its arguments.

    Of each look of an experiment one is open: a cell that runs again closes the one before.
    """

    _open: ClassVar[dict[tuple[str, str], Explorer]] = {}

    def __init__(self, exp: Experiment[Any], look: str, profile: str) -> None:
        self._kit = widgets()
        self._exp, self._look, self._profile = exp, look, profile
        if (former := self._open.pop((exp.name, look), None)) is not None:
            former.close()
        declared = exp.looks[look]
        self.form = Form(
            exp.config(profile, **declared.start), declared.turn, self._ask, declared.within
        )
        #: The request whose picture is shown, and whether it is the whole picture.
        self.shown, self.whole = -1, False
        self.kept: list[str] = []  #: Logs that were kept.
        self._request = -1
        self._settled = threading.Event()
        self._running: Worker | None = None
        self._outcome = ""
        self._picture, self._before = self._kit.Image(), self._kit.Image()
        self._before.layout.width, self._before.layout.display = "45%", "none"
        self._before.add_class(_FAINT)
        self._code = self._kit.Textarea(layout={"width": "40em", "display": "none"}, rows=3)
        self._state = self._kit.HTML()
        self._drawing = self._kit.HTML()  #: Its value says whether the picture is being computed.
        self._result = self._kit.VBox()  #: What *Run all* measured.
        self._bar = self._kit.IntProgress(layout={"display": "none"})
        self._buttons = {
            "reset": button("Reset", self.form.reset, "Every field as in the beginning"),
            "code": button("Copy as code", self._show_code, "The call that repeats this"),
            "keep": button("Keep", self.keep, "Write a log of this into runs/, marked as explored"),
            "all": button(
                "Run all", self.run_all, "Run everything with these settings, live parts too"
            ),
            "stop": button("Stop", self.stop, "Stop what runs; nothing of it is kept"),
        }
        self._buttons["stop"].disabled = True
        self.widget = self._arranged()
        self._worker = Worker(Task(experiment=exp.name), self._take)
        self._open[exp.name, look] = self
        self._ask()

    def _repr_mimebundle_(self, **_: object) -> tuple[dict[str, Any], dict[str, Any]]:
        """Show the form, and its first picture as a still where no kernel runs."""
        self.wait()
        return still_bundle(self.widget, self._picture.value, self._exp.looks[self._look].draw)

    def wait(self, timeout_s: float = _FIRST_PICTURE_S) -> bool:
        """Wait until the picture is whole and the newest one's; returns whether it is in time, not refused."""
        return self._settled.wait(timeout_s) and self.whole and self.shown == self._request

    def code(self) -> str:
        """Return the call that repeats what is shown."""
        now = to_json(self.form.config)
        usual = to_json(self._exp.config(self._profile))
        changes = {name: _plain(now[name]) for name in now if now[name] != usual[name]}
        given = "".join(f", {name}={value!r}" for name, value in changes.items())
        name = self._exp.name
        call = f'await {name}.exp.run("{self._profile}"{given})'
        return f"from sfglab.lab.experiments import {name}\nrun = {call}"

    def keep(self) -> None:
        """Write what is shown into a log below ``runs/``, marked as explored: it speaks for no claim."""
        self._run(tuple(sorted(self._exp.looks[self._look].needs)))

    def run_all(self) -> None:
        """Run the whole experiment with these settings, live parts too; its log is marked as explored."""
        self._run(None)

    def stop(self) -> None:
        """Stop what runs on a button; what it started ends with it."""
        if self._running is not None:
            self._running.close()

    def close(self) -> None:
        """End the worker and what runs; harmless when repeated."""
        self.stop()
        self._worker.close()

    # The picture.

    def _ask(self) -> None:
        self._request += 1
        self._settled.clear()
        self._drawing.value = "computing ..."
        self._worker.order(
            do="draw", request=self._request, look=self._look, config=to_json(self.form.config)
        )

    def _take(self, report: Report) -> None:
        if report["is"] == "ended":
            self.form.say("the process that draws has ended: run the cell again")
            self._settled.set()
            return
        if report.get("request") != self._request:
            return
        if report["is"] == "refused":
            self.form.say(report["why"])
            self._drawing.value = ""
            self._settled.set()
            return
        if self.whole and self.shown != self._request:
            self._before.value, self._before.layout.display = self._picture.value, ""
        self._picture.value = base64.b64decode(report["png"])
        self.shown, self.whole = self._request, report["whole"]
        self._drawing.value = "" if self.whole else "a coarse preview; computing ..."
        if self.whole:
            self._settled.set()

    # What runs on a button.

    def _run(self, only: tuple[str, ...] | None) -> None:
        if self._running is not None:
            self._state.value = "one run at a time: stop the other first"
            return
        settings = to_json(self.form.config)
        settings.pop("profile", None)
        self._log = new_log(find_project(), self._exp.name, self._profile)
        name, log = self._exp.name, str(self._log)
        task = Task(experiment=name, profile=self._profile, log=log, settings=settings, only=only)
        self._outcome = ""
        self._show_busy(busy=True)
        self._running = Worker(task, self._follow)

    def _follow(self, report: Report) -> None:
        if report["is"] == "step":
            self._bar.max, self._bar.value = report["total"], report["done"]
            self._state.value = f"{report['what']}; {report['left_s']:.0f} s left"
        elif report["is"] == "done":
            self.kept.append(report["log"])
            log = find_project().relative(Path(report["log"]))
            self._outcome = f"kept as {log}; it was explored and counts for no claim"
            if "figures" in report:
                self._show_result(report, log)
            self.stop()
        elif report["is"] == "failed":
            self._outcome = report["why"]
        elif report["is"] == "ended":
            unfinished_of(self._log).unlink(
                missing_ok=True
            )  # a process that was ended by force left it
            self._state.value = self._outcome or "stopped; nothing was kept"
            self._running = None
            self._show_busy(busy=False)

    def _show_busy(self, *, busy: bool) -> None:
        self._bar.layout.display, self._bar.value = "" if busy else "none", 0
        if busy:
            self._state.value = "starting"
        for name, made in self._buttons.items():
            made.disabled = busy != (name == "stop")

    def _show_result(self, report: Report, log: str) -> None:
        """Show what was measured: the experiment's own figures of this run, and its claims."""
        name = self._exp.name
        call = f'run = await notebook.run({name}.exp, "{self._profile}", log="{log}")'
        head = f"<b>Measured with these settings</b>; open it again: <code>{escape(call)}</code>"
        failed = "".join(refusal_html(f"{text}. ") for text in report["failed"])
        pictures = [
            self._kit.Image(value=base64.b64decode(png), layout={"max_width": "100%"})
            for png in report["figures"].values()
        ]
        text = self._kit.HTML(f"{head}<br>{failed}")
        self._result.children = (text, *pictures, self._kit.HTML(report["claims"]))

    # How it looks.

    def _show_code(self) -> None:
        self._code.value, self._code.layout.display = self.code(), ""

    def _arranged(self) -> Any:
        kit, reference = self._kit, self._reference()
        below = kit.HBox(
            [kit.HTML(_STYLE), self._before, *([reference] if reference is not None else [])]
        )
        buttons = kit.HBox([*self._buttons.values()])
        state = kit.HBox([self._bar, self._state, self._drawing])
        rows = [self.form.widget, buttons, state, self._code, self._picture, below, self._result]
        return kit.VBox(rows)

    def _reference(self) -> Any | None:
        """Return the reference run's figure in a fold; None where the look names none, or it is not there."""
        file = find_project().figures / f"{self._exp.looks[self._look].reference}.png"
        if not file.is_file():
            return None
        picture = self._kit.Image(value=file.read_bytes(), layout={"width": "100%"})
        return self._kit.Accordion(
            children=[picture], titles=("Reference run",), selected_index=None
        )


def _plain(value: Any) -> Any:
    return tuple(map(_plain, value)) if isinstance(value, list) else value


def explore(
    what: Experiment[Any] | Callable[..., Any], look: str = "", *, profile: str = "quick"
) -> Explorer | Interactive:
    """Show sliders, and a figure that follows them.

        explore(transfer.exp)

    Args:
        what: Experiment, or a function that returns a `Picture` (see `Experiment.explorer`).
        look: Name of the experiment's explorer. [default: the first]
        profile: Profile of the configuration that the sliders of a `Look` change.

    Raises:
        InvalidValueError: The experiment has no such explorer.
        MissingExtraError: The extra ``view`` is not installed.
    """
    if not isinstance(what, Experiment):
        return Interactive(what)
    names = [*what.explorers, *what.looks]
    chosen = look or next(iter(names), "")
    if chosen in what.explorers:
        return Interactive(what.explorers[chosen])
    if chosen not in what.looks:
        allowed = ", ".join(names) or "none: nothing to turn"
        raise InvalidValueError(f"{what.name}: look", look, allowed)
    return Explorer(what, chosen, profile)
