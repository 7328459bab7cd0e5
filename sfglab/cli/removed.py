"""Removed commands and former names of options, up to and including 0.1.0.

A removed command prints its replacement and exits with status 2. A former name of an option is
accepted with a warning.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, NoReturn

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

#: The replacement of each removed command.
REPLACEMENTS = {
    "service": "use ros2 service",
    "action": "use ros2 action",
    "param": "use ros2 param, after sfglab agent up --parameters ros for our components",
    "topic info": "use ros2 topic info, or sfglab topic list -t for the types",
    "topic bw": "use ros2 topic bw, or sfglab topic hz for the rate",
    "node info": "use ros2 node info",
    "log convert": "use ros2 bag convert, which reads our MCAP files",
    "log filter": "use ros2 bag convert, or sfglab log play with --topics, --regex or --start-offset",
    "fleet check": "use sfglab fleet router, which writes a DDS Router's file from the policy",
    "fleet security": "use ros2 security (sros2), which creates keys and permissions",
    "mocap offset": "measure the object's offset and write it into the mapping, "
    "as in data/mocap/two_agents.yaml",
}
#: The former names of options and values of each command, and today's.
RENAMED = {
    "qos": {
        "--front": "--pareto",
        "--latency-price": "--latency-weight",
        "--method printed": "--method paper",
    },
    "map": {"--rule": "--gateway-rule", "--place": "--optimise-placement"},
    "mocap run": {"--trees": "--publish-tf"},
}
# The sentence is all that a removed command prints, also for --help.
_ANYTHING = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": [],
}


def add_removed(apps: Mapping[str, typer.Typer]) -> None:
    """Add each removed command, hidden, to its group; the program itself has the name ``""``."""
    for command in REPLACEMENTS:
        group, _, name = command.rpartition(" ")
        apps[group].command(name, hidden=True, context_settings=_ANYTHING)(_refusal(command))


def _refusal(command: str) -> Callable[[typer.Context], None]:
    # typer gives the rest of the line to the parameter that is annotated as its context.
    def refused(_context: typer.Context) -> None:
        refuse(command, REPLACEMENTS[command])

    return refused


def refuse(command: str, replacement: str) -> NoReturn:
    """Print what replaces a removed command, or a removed value of an option, and exit with status 2."""
    typer.echo(f"sfglab {command} was removed: {replacement}", err=True)
    raise typer.Exit(2)


class RenamedOptions(TyperCommand):
    """A command that accepts former names of its options, with a warning."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments in which former names are replaced."""
        command = ctx.command_path.partition(" ")[2]
        return super().parse_args(ctx, list(_todays(args, RENAMED[command])))


def _todays(args: list[str], renamed: Mapping[str, str]) -> Iterator[str]:
    """Yield arguments with today's names of options and values."""
    options = {former.partition(" ")[0] for former in renamed}
    words = []
    for arg in args:
        name, equals, value = arg.partition("=")
        words += [name, value] if equals and name in options else [arg]
    for before, word in pairwise(["", *words]):
        former = word if word in renamed else f"{before} {word}"
        if former in renamed:
            typer.echo(f"warning: {former} is now called {renamed[former]}", err=True)
            yield renamed[former].rpartition(" ")[2]
        else:
            yield word
