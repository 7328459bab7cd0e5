"""Files of an agent's folder, some of them rendered from templates; only this module uses Jinja."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from functools import cache
from typing import Any

PLAIN = 0o644
PROGRAM = 0o755


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleFile:
    """Content and permissions of a file of an agent's folder."""

    data: bytes  #: Content of the file.
    mode: int = PLAIN  #: Permissions of the file.

    @property
    def text(self) -> str:
        """Content of the file, decoded as UTF-8."""
        return self.data.decode()


def text_file(text: str, mode: int = PLAIN) -> BundleFile:
    """Return a text file with permissions ``PLAIN`` or ``PROGRAM``."""
    return BundleFile(data=text.encode(), mode=mode)


def render(name: str, **values: Any) -> str:
    """Render a template of the folder ``templates`` with values; ``value | sh`` in a template quotes for a shell.

    Raises:
        jinja2.UndefinedError: A value is missing.
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
    """Return a text without line breaks, as in a comment of one line."""
    return " ".join(text.split())
