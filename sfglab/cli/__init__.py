"""The command line: ``sfglab --help``.

Each command is a few lines over the library; heavy modules are imported by the command that needs them.
Commands of one kind stand in one module and are added to the program here.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from errno import EFBIG, EIO, ENOSPC
from inspect import cleandoc
from os import fsdecode
from typing import Annotated, Any, NoReturn

import typer
from typer import Option
from typer.core import TyperGroup

from sfglab import __version__
from sfglab.cli import (
    deploy,
    experiments,
    fleet,
    interfaces,
    logs,
    mapping,
    mocap,
    nodes,
    plan,
    removed,
    schema,
    topics,
    view,
)
from sfglab.errors import SfglabError, why

__all__ = ["app", "main"]


class _Program(TyperGroup):
    """All commands; Ctrl-C is one line, whichever runs."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            typer.echo("sfglab: interrupted", err=True)
            raise typer.Exit(130) from None


app = typer.Typer(
    cls=_Program,
    help="How multi-robot ROS 2 systems move data: run the experiments, or the components beside real robots.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
_COMMANDS: dict[str, Callable[..., None]] = {
    "doctor": experiments.doctor,
    "reproduce": experiments.reproduce,
    "try": experiments.try_experiment,
    "lab": experiments.lab,
    "figures": experiments.figures,
    "claims": experiments.claims,
    "router": fleet.router,
    "decoder": fleet.decoder,
    "camera": fleet.camera,
    "interfaces": interfaces.interfaces,
    "schema": schema.schema,
    "qos": mapping.qos,
    "map": mapping.map_graph,
    "plan": plan.plan,
    "view": view.view,
}
_GROUPS = {
    "agent": fleet.agent_app,
    "fleet": fleet.fleet_app,
    "deploy": deploy.app,
    "follow": plan.app,
    "mocap": mocap.mocap_app,
    "frames": mocap.frames_app,
    "log": logs.app,
    "topic": topics.app,
    "node": nodes.node_app,
}
for _name, _command in _COMMANDS.items():
    _former = removed.RenamedOptions if _name in removed.RENAMED else None
    app.command(_name, cls=_former)(_command)
for _name, _group in _GROUPS.items():
    app.add_typer(_group, name=_name, short_help=(_group.info.help or "").partition("\n\n")[0])
removed.add_removed({"": app, **_GROUPS})
for _each in (app, *_GROUPS.values()):
    for _one in _each.registered_commands:  # whole in the lists of commands, where typer cuts
        _text = cleandoc((_one.callback and _one.callback.__doc__) or "")
        _one.short_help = " ".join(_text.partition("\n\n")[0].split())
        _one.help = _text.replace("\n\nExample", "\n\n\b\nExample")  # a line each, as written


def main() -> NoReturn:
    """Run the command line; an error of ours is one line and exit status 1, of its words exit status 2."""
    logging.basicConfig(format="%(levelname)s: %(message)s", level=logging.WARNING)
    try:
        status = app(prog_name="sfglab", standalone_mode=False)
        sys.stdout.flush()
    except Exception as error:
        said, status = _sentence(error)
        if not said:
            raise
        typer.echo(f"sfglab: {said}", err=True)
        # Say what is still buffered; what standard output cannot take is not tried again at the end.
        try:
            sys.stdout.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(status)


def _sentence(error: Any) -> tuple[str, int]:
    """Return an error in words, none where it is a fault of ours, and an exit status."""
    if isinstance(error, SfglabError):
        return str(error), 1
    if isinstance(error, OSError) and error.filename is not None:
        return f"{fsdecode(error.filename)}: {why(error)}", 1
    if (
        isinstance(error, ModuleNotFoundError)
        and error.name
        and not error.name.startswith("sfglab")
    ):
        return (
            f"this needs {error.name}, which sfglab brings, and sfglab-robot[depth] for depth and frames",
            1,
        )
    if isinstance(error, OSError) and error.errno in (ENOSPC, EFBIG, EIO):
        return f"standard output: {why(error)}", 1
    if not hasattr(
        error, "format_message"
    ):  # typer brings a click of its own, or takes the installed one
        return "", 1
    if type(error).__name__ == "NoArgsIsHelpError":  # a group without a command
        error.show()
        sys.exit(error.exit_code)
    said = " ".join(error.format_message().split())
    path = error.ctx.command_path.partition(" ")[2] if error.ctx else ""
    return f"{path}: {said}" if path else said, error.exit_code


def _version(value: bool) -> None:
    if value:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of the program itself."""
