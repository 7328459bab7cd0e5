"""Progress: a bar in a terminal, plain lines in a file, steps for whoever listens."""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tqdm import tqdm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@dataclass(frozen=True, slots=True)
class Step:
    """A step that is done."""

    what: str  #: What is going on, and the step.
    done: int  #: How many are done.
    total: int  #: How many there are.
    left_s: float  #: Time left at the pace until now, seconds.


_LISTENER: ContextVar[Callable[[Step], None] | None] = ContextVar("listener", default=None)


@contextmanager
def progress_to(listener: Callable[[Step], None]) -> Iterator[None]:
    """Tell steps to a listener instead of standard error, here and in what is called here."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


@contextmanager
def progress_bar(total: int, what: str) -> Iterator[Callable[[str], None]]:
    """Show progress on standard error, or tell it to who listens.

    Args:
        total: Number of steps.
        what: What is going on.

    Yields:
        A function to call after each step, with what the step was.
    """
    listener = _LISTENER.get()
    if listener is not None:
        yield _telling(total, what, listener)
        return
    # A log file or a captured stream gets a line now and then instead of a living bar.
    period_s = 0.1 if sys.stderr.isatty() else 5.0
    with tqdm(total=total, desc=what, file=sys.stderr, dynamic_ncols=True, mininterval=period_s) as bar:

        def advance(step: str) -> None:
            bar.set_postfix_str(step, refresh=False)
            bar.update()

        yield advance


def _telling(total: int, what: str, listener: Callable[[Step], None]) -> Callable[[str], None]:
    start_s, done = time.monotonic(), 0

    def advance(step: str) -> None:
        nonlocal done
        done += 1
        left_s = (time.monotonic() - start_s) / done * max(total - done, 0)
        listener(Step(f"{what}, {step}", done, total, left_s))

    return advance
