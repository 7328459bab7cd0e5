"""Commands that were removed: each names its replacement and ends with status 2, up to and including 0.1.0."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: The replacement of each removed command.
REPLACEMENTS = {
    "service": "ros2 service does this",
    "action": "ros2 action does this",
    "param": "ros2 param does this, and sfglab agent up --parameters ros lets it read our components",
    "topic info": "ros2 topic info does this, and sfglab topic list -t prints the types",
    "topic bw": "ros2 topic bw does this, and sfglab topic hz prints the rate",
    "node info": "ros2 node info does this",
    "mocap offset": "measure the object's offset and write it into the mapping, "
    "as data/mocap/two_agents.yaml does",
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
    def refuse(_context: typer.Context) -> None:
        typer.echo(f"sfglab {command}: was removed; {REPLACEMENTS[command]}", err=True)
        raise typer.Exit(2)

    return refuse
