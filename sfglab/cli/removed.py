"""Removed commands and former names of options, up to and including 0.1.0.

A removed command or option prints its replacement and exits with status 2. A former name of an option is
accepted with a warning.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

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
#: The former names of options and of values, and today's; no command has another use for them.
RENAMED = {
    "--front": "--pareto",
    "--latency-price": "--latency-weight",
    "printed": "paper",
    "--rule": "--gateway-rule",
    "--place": "--optimise-placement",
    "--trees": "--publish-tf",
    "--seconds": "--duration",
    "--listen": "--duration",
    "--out": "--output",
    "--frame": "--root-frame",
}
# Options of one command each. The former fast_dds of --vendor is none of the values of --rmw.
_REMOVED = {
    "vendor": ("qos --vendor", "use --rmw fastrtps-sync, --rmw fastrtps-async or --rmw cyclone"),
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


def _refusal(command: str) -> Callable[[], None]:
    def refused() -> None:
        refuse(command, REPLACEMENTS[command])

    return refused


def refuse(command: str, replacement: str) -> NoReturn:
    """Print what replaces a removed command, option or value, and exit with status 2."""
    typer.echo(f"sfglab {command} was removed: {replacement}", err=True)
    raise typer.Exit(2)


def current_name(token: str) -> str:
    """Return the name of an option, without dashes, or of a value; for a former one today's, with a warning."""
    if token in _REMOVED:
        refuse(*_REMOVED[token])
    for former in (token, f"--{token}"):
        if former in RENAMED:
            current = RENAMED[former]
            typer.echo(f"warning: {former} is now called {current}", err=True)
            return current.removeprefix("--")
    return token
