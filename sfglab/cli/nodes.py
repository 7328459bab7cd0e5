"""Commands that look at nodes: ``sfglab node``, in the words of ``ros2 node``."""

from __future__ import annotations

from typing import Annotated

import typer

from sfglab.cli.buses import Count, Domain, Hidden, Interface, Json, SpinTime, look, tell

app = typer.Typer(help="Nodes of a domain, in the words of ros2 node.", no_args_is_help=True)


@app.command("list")
def list_nodes(
    hidden: Annotated[bool, typer.Option("--all", "-a", help="Consider names below _ as well.")] = False,
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


@app.command()
def info(
    node: Annotated[str, typer.Argument(help="Full name of the node, e.g. /talker")],
    hidden: Hidden = False,
    as_json: Json = False,
    domain: Domain = None,
    interface: Interface = None,
    spin: SpinTime = None,
) -> None:
    """Say what a node publishes, subscribes to, serves and calls.

    Example:

      sfglab node info /talker --domain 7
    """
    found = look((domain, interface), spin).of_node(node, hidden=hidden)
    if as_json:
        tell({"name": node, **{head.lower().replace(" ", "_"): names for head, names in found.items()}})
        return
    typer.echo(node)
    for head, names in found.items():
        typer.echo(f"  {head}:")
        lines = [f"    {name}: {', '.join(types)}" for name, types in names.items()]
        typer.echo("\n".join(lines))
