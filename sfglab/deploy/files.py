"""Files of an agent's folder, and the texts with holes that some are made from: the one door to Jinja."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from functools import cache
from typing import Any

PLAIN = 0o644
PROGRAM = 0o755


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleFile:
    """A text file of an agent's folder."""

    text: str  #: Text of the file.
    mode: int = PLAIN  #: Its permissions, ``PLAIN`` or ``PROGRAM``.


def render(name: str, **values: Any) -> str:
    """Return a file of the folder ``templates`` with its holes filled; ``value | sh`` quotes for a shell.

    Raises:
        jinja2.UndefinedError: A hole has no value.
    """
    return str(_templates().get_template(name).render(**values))


@cache
def _templates() -> Any:
    """Return Jinja with our templates, each compiled once."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(__package__),
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701 - what is written is no HTML
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["sh"] = lambda value: shlex.quote(str(value))
    return environment


def one_line(text: str) -> str:
    """Return a text fit for a comment's line, which it cannot leave."""
    return " ".join(text.split())
