"""The one place that imports viser, so that everything else can be imported without it; and keeps it quiet."""

from __future__ import annotations

from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any

from sfglab.errors import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Iterator


def viser() -> Any:
    """Return viser.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        return import_module("viser")
    except ImportError as error:
        raise MissingExtraError("viser", extra="view", purpose="the scene editor") from error


@contextmanager
def quiet() -> Iterator[None]:
    """Keep viser from drawing its banner into the terminal; what there is to say, we say."""
    console = import_module("rich").get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before
