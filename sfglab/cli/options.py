"""Habits of all commands: what was written is said, and an option that nothing looks at is refused."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

import typer

from sfglab.errors import SfglabError
from sfglab.files import write_files

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


def put(files: Mapping[Path, str | bytes], folder: Path | None = None) -> None:
    """Write files, all or none, and say which; below a folder, which is made, if one is given.

    Raises:
        InvalidValueError: One cannot be written.
    """
    write_files(files, folder=folder)
    for path in files:
        typer.echo(path if folder is None else folder / path)


def unused(why: str, *names: str) -> None:
    """Refuse options that were given where nothing looks at them; their parameters' names, and why.

    Raises:
        SfglabError: One was given.
    """
    # typer brings a click of its own, or takes the installed one
    click = import_module(typer.Context.__mro__[1].__module__.partition(".core")[0] + ".globals")
    context = click.get_current_context()
    options = {parameter.name: max(parameter.opts, key=len) for parameter in context.command.params}
    given = [
        options[name]
        for name in names
        if getattr(context.get_parameter_source(name), "name", "") == "COMMANDLINE"
    ]
    if given:
        raise SfglabError(f"{' and '.join(given)}: given {why}")
