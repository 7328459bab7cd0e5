"""Removed commands and former names of options, up to and including 0.1.0.

A removed command prints its replacement and exits with status 2. A former name of an option is
accepted with a warning.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

#: The replacement of each removed command.
REPLACEMENTS = {
    "service": "ros2 service does this",
    "action": "ros2 action does this",
    "param": "ros2 param does this, and sfglab agent up --parameters ros lets it read our components",
    "topic info": "ros2 topic info does this, and sfglab topic list -t prints the types",
    "topic bw": "ros2 topic bw does this, and sfglab topic hz prints the rate",
    "node info": "ros2 node info does this",
    "fleet check": "sfglab fleet router writes the DDS Router's file from the policy anew",
    "fleet security": "ros2 security (sros2) creates keys, certificates and permissions",
    "mocap offset": "measure the object's offset and write it into the mapping, "
    "as data/mocap/two_agents.yaml does",
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
# Whatever follows the name is ignored, --help included: the sentence is the help.
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
    typer.echo(f"sfglab {command}: was removed; {replacement}", err=True)
    raise typer.Exit(2)


class RenamedOptions(TyperCommand):
    """A command that accepts former names of its options, with a warning."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments in which former names are replaced."""
        command = ctx.command_path.partition(" ")[2]
        return super().parse_args(ctx, list(_todays(args, RENAMED[command])))


def _todays(args: list[str], renamed: Mapping[str, str]) -> Iterator[str]:
    """Yield arguments with today's names; a value may follow its option as a word or behind ``=``."""
    before = ""
    for arg in args:
        name, equals, value = arg.partition("=")
        option, given = (name, value) if equals else (before, arg)
        before = arg
        if name in renamed:
            _warn(name, renamed[name])
            yield renamed[name] + equals + value
        elif f"{option} {given}" in renamed:
            new = renamed[f"{option} {given}"]
            _warn(f"{option} {given}", new)
            yield new.replace(" ", "=") if equals else new.rpartition(" ")[2]
        else:
            yield arg


def _warn(former: str, new: str) -> None:
    typer.echo(f"warning: {former} is now called {new}", err=True)
