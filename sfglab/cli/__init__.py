"""The command line: ``sfglab --help``.

Each command is a few lines over the library and imports heavy modules itself. Commands of one kind
are in one module and are added to the program here.

The package declares about 100 options and arguments and prints the reports of all commands, which explains its size.
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

from sfglab import __version__
from sfglab.cli import (
    deploy,
    experiments,
    fleet,
    interfaces,
    logs,
    mapping,
    mocap,
    plan,
    qos,
    removed,
    schema,
    topics,
    view,
)
from sfglab.errors import SfglabError, why

__all__ = ["app", "main"]


def _set_help(info: Any, text: str | None) -> None:
    """Show the first paragraph whole in lists, where typer would cut it, and keep the examples' lines."""
    text = cleandoc(text or "")
    info.short_help = " ".join(text.partition("\n\n")[0].split())
    info.help = text.replace("\n\nExample", "\n\n\b\nExample")


app = typer.Typer(
    help="""Run components for multi-robot ROS 2 systems, and the experiments of three papers.

Paper A: communication between robots. Paper B: QoS of topics on a wireless link. Paper C: topics
between software and hardware (FPGA). The exit status is 0 on success, 2 for arguments that cannot
be parsed, and 1 for other errors.

Examples:
  sfglab doctor
  sfglab reproduce --profile smoke
  sfglab agent up --domain 7""",
    no_args_is_help=True,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "token_normalize_func": removed.current_name,
    },
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
    "hub": fleet.hub,
    "decoder": fleet.decoder,
    "camera": fleet.camera,
    "interfaces": interfaces.interfaces,
    "schema": schema.schema,
    "qos": qos.qos,
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
    "node": topics.node_app,
}
for _name, _command in _COMMANDS.items():
    app.command(_name)(_command)
for _name, _group in _GROUPS.items():
    app.add_typer(_group, name=_name, no_args_is_help=_name != "log")
removed.add_removed({"": app, **_GROUPS})
for _app in (app, *_GROUPS.values()):
    _set_help(_app.info, _app.info.help)
    for _info in _app.registered_commands:
        _set_help(_info, _info.callback and _info.callback.__doc__)


#: Exit status of a command that Ctrl-C ended; typer returns it for each command.
_INTERRUPTED = 130


def main() -> NoReturn:
    """Run the command line and exit.

    An error of sfglab is one line and exit status 1, an error in the arguments is exit status 2.
    """
    logging.basicConfig(format="%(levelname)s: %(message)s", level=logging.WARNING)
    try:
        status = app(prog_name="sfglab", standalone_mode=False)
        if status == _INTERRUPTED:
            typer.echo("sfglab: interrupted", err=True)
        sys.stdout.flush()
    except Exception as error:
        sentence, status = _sentence(error)
        if not sentence:
            raise
        typer.echo(f"sfglab: {sentence}", err=True)
        try:
            sys.stdout.flush()
        except OSError:
            # The interpreter must not try again to write what standard output refused.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(status)


def _sentence(error: Any) -> tuple[str, int]:
    """Return an error as a sentence, empty for a bug of sfglab, and the exit status."""
    if isinstance(error, SfglabError):
        return str(error), 1
    if isinstance(error, OSError):
        if error.filename is not None:
            return f"{fsdecode(error.filename)}: {why(error)}", 1
        if error.errno in {ENOSPC, EFBIG, EIO}:
            return f"standard output: {why(error)}", 1
    if isinstance(error, ModuleNotFoundError):
        name = error.name or "sfglab"
        if not name.startswith("sfglab"):
            return f"{name} is not installed; install sfglab, or on a robot sfglab-robot[depth]", 1
    # typer brings its own click or uses the installed one, so the class of its errors is not known.
    if not hasattr(error, "format_message"):
        return "", 1
    if type(error).__name__ == "NoArgsIsHelpError":
        error.show()
        sys.exit(error.exit_code)
    return _usage_sentence(error), error.exit_code


def _usage_sentence(error: Any) -> str:
    """Return an error in the arguments of a command as a sentence that names the command's help."""
    sentence = " ".join(error.format_message().split()).replace("Value error, ", "")
    if "Input should be" in sentence:
        given = error.__cause__.errors()[0]["input"]
        sentence = sentence.replace("Input should be", f"given {given!r}, allowed:")
        sentence = sentence.partition(", unable to parse")[0]
    command = error.ctx.command_path if error.ctx else "sfglab"
    if not sentence.endswith("?"):
        sentence = f"{sentence.removesuffix('.')}; see {command} --help"
    path = command.partition(" ")[2]
    return f"{path}: {sentence}" if path else sentence


def _print_version(value: bool) -> None:
    if value:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Define the options of the program itself."""
