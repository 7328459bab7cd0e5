"""Texts with holes: the one door to Jinja."""

from __future__ import annotations

import shlex
from typing import Any


def render(package: str, name: str, **values: Any) -> str:
    """Return a template of a package with its holes filled; ``value | sh`` quotes for a shell.

    Args:
        package: The package whose folder ``templates`` holds it, as in ``sfglab.deploy.host``.
        name: File name of the template.
        values: What its holes are filled with.

    Raises:
        jinja2.UndefinedError: A hole has no value.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701 - what is written is no HTML
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["sh"] = lambda value: shlex.quote(str(value))
    return environment.get_template(name).render(**values)
