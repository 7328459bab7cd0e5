"""Commands about nodes: ``sfglab node``, in the words of ``ros2 node``."""

from __future__ import annotations

from typing import Annotated

import typer
from typer import Option

from sfglab.cli.buses import Count, Domain, Interface, Json, SpinTime, look, tell

node_app = typer.Typer(help="Nodes of a domain, in the words of ros2 node.", no_args_is_help=True)
# With a single command typer would leave its name out.
node_app.callback()(lambda: None)


@node_app.command("list")
def list_nodes(
    hidden: Annotated[bool, Option("--all", "-a", help="Consider names below _ as well.")] = False,
    count: Count = False,
    as_json: Json = False,
    domain: Domain = None,
    interface: Interface = None,
    spin: SpinTime = None,
) -> None:
    """List nodes.

    Examples:
      sfglab node list
      sfglab node list --domain 7
    """
    from sfglab.bus.listing import is_hidden

    nodes = look((domain, interface), spin).nodes
    names = [node.full_name for node in nodes if hidden or not is_hidden(node.full_name)]
    if as_json:
        tell(names)
    else:
        typer.echo(f"{len(names)}\n" if count else "".join(f"{name}\n" for name in names), nl=False)
