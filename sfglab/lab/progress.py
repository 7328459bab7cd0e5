"""Progress bars that work in a terminal, in a notebook and headless."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tqdm import tqdm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextmanager
def progress_bar(total: int, what: str) -> Iterator[Callable[[str], None]]:
    """Show progress on standard error.

    Args:
        total: Number of steps.
        what: What is going on.

    Yields:
        A function to call after each step, with what the step was.
    """
    # A log file or a captured stream gets a line now and then instead of a living bar.
    period_s = 0.1 if sys.stderr.isatty() else 5.0
    with tqdm(total=total, desc=what, file=sys.stderr, dynamic_ncols=True, mininterval=period_s) as bar:

        def advance(step: str) -> None:
            bar.set_postfix_str(step, refresh=False)
            bar.update()

        yield advance
