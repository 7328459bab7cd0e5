"""Progress: a bar in a terminal, a widget in JupyterLab, and plain lines elsewhere."""

from __future__ import annotations

import os
import re
import sys
import time
from contextlib import contextmanager
from functools import partial
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


#: Shortest time between two updates of a bar, s.
_BAR_S = 0.1
#: Shortest time between two lines, s.
_LINES_S = 5.0
_LINE = re.compile(r"\d+/\d+ steps, \d+ s left$")


@contextmanager
def progress_bar(total: int, what: str) -> Iterator[Callable[[str], None]]:
    """Show the progress of `total` steps of a job `what`; yield the function to call after each step."""
    if _in_jupyterlab():
        with _widget(total, what) as show:
            yield _reporter(total, what, show, _BAR_S)
    elif sys.stderr.isatty():
        with tqdm(
            total=total, desc=what, file=sys.stderr, dynamic_ncols=True, mininterval=_BAR_S
        ) as bar:
            yield partial(_move, bar)
    else:
        yield _reporter(total, what, _print_line, _LINES_S)


def _move(bar: Any, step: str) -> None:
    bar.set_postfix_str(step, refresh=False)
    bar.update()


def _print_line(_done: int, line: str) -> None:
    """Print a line. In a notebook it goes to standard output, because errors have a red box."""
    print(line, file=sys.stdout if _in_kernel() else sys.stderr, flush=True)


def _reporter(
    total: int, what: str, show: Callable[[int, str], None], period_s: float
) -> Callable[[str], None]:
    """Return a function that shows at most one step per period, and the last one.

    `show` takes the number of steps that are done, and a line that `is_line` recognises.
    """
    start_s = reported_s = time.monotonic()
    done = 0

    def advance(step: str) -> None:
        nonlocal done, reported_s
        done += 1
        now_s = time.monotonic()
        if done == total or now_s - reported_s >= period_s:
            reported_s = now_s
            left_s = (now_s - start_s) / done * max(total - done, 0)
            show(done, f"{what}, {step}: {done}/{total} steps, {left_s:.0f} s left")

    return advance


def is_line(text: str) -> bool:
    """Return whether a line is one of progress."""
    return bool(_LINE.search(text))


def _in_kernel() -> bool:
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


def _in_jupyterlab() -> bool:
    """Return whether a page shows widgets: a server names the session, papermill does not."""
    return _in_kernel() and "JPY_SESSION_NAME" in os.environ and find_spec("ipywidgets") is not None


@contextmanager
def _widget(total: int, what: str) -> Iterator[Callable[[int, str], None]]:
    """Show a widget. At the end a plain line replaces it, which needs no kernel."""
    from IPython.display import display

    from sfglab.view.widgets import widgets

    kit = widgets()
    bar, text = kit.IntProgress(max=total), kit.HTML(escape(what))
    handle = display(kit.HBox([bar, text]), display_id=True)

    def show(done: int, line: str) -> None:
        bar.value = done
        text.value = escape(line)

    try:
        yield show
    finally:
        handle.update({"text/plain": f"{what}: {bar.value} of {total} steps"}, raw=True)
