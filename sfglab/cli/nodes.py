"""Commands about nodes: ``sfglab node`` and ``param``, in the words of ``ros2 node`` and ``param``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from sfglab.cli.buses import (
    Count,
    Domain,
    Hidden,
    Interface,
    Json,
    SpinTime,
    call,
    look,
    on_node,
    tell,
)
from sfglab.errors import InvalidValueError, SfglabError

if TYPE_CHECKING:
    from sfglab.bus import Node

node_app = typer.Typer(help="Nodes of a domain, in the words of ros2 node.", no_args_is_help=True)
param_app = typer.Typer(
    help="Parameters of nodes, in the words of ros2 param.", no_args_is_help=True
)
_Node = Annotated[str, Argument(metavar="NODE", help="Full name of the node, e.g. /agent_decoder")]
_Name = Annotated[str, Argument(help="Name of the parameter.")]
_Timeout = Annotated[float, Option(min=0.1, help="Seconds to wait for the node's answer.")]
_SECONDS = 10.0
_LIST = "/list_parameters"


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


@node_app.command()
def info(
    node: Annotated[str, Argument(help="Full name of the node, e.g. /talker")],
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
        tell(
            {
                "name": node,
                **{head.lower().replace(" ", "_"): names for head, names in found.items()},
            }
        )
        return
    typer.echo(node)
    for head, names in found.items():
        typer.echo(f"  {head}:")
        typer.echo("\n".join(f"    {name}: {', '.join(types)}" for name, types in names.items()))


@param_app.command("list")
def list_parameters(
    node_name: Annotated[
        str | None, Argument(metavar="NODE", help="Full name of the node; all nodes when none.")
    ] = None,
    as_json: Json = False,
    timeout: _Timeout = _SECONDS,
    domain: Domain = None,
    interface: Interface = None,
    spin: SpinTime = None,
) -> None:
    """List the parameters of a node, or of all nodes.

    Examples:
      sfglab param list --domain 7
      sfglab param list /agent_decoder --domain 7
    """

    async def ask(node: Node) -> dict[str, list[str]]:
        return {
            name: await _names(node, name, timeout) for name in await _nodes(node, node_name, spin)
        }

    found = on_node((domain, interface), ask)
    if as_json:
        tell(found)
        return
    for name, parameters in found.items():
        lines = ([] if node_name else [f"{name}:"]) + [f"  {one}" for one in parameters]
        typer.echo("".join(f"{line}\n" for line in lines), nl=False)


async def _nodes(node: Node, given: str | None, spin_s: float | None) -> list[str]:
    """Return the nodes to ask: the one that is given, else all that have parameters."""
    from sfglab.bus.listing import settled

    if given is not None:
        return [_absolute(given)]
    services = (await settled(node, spin_s)).services()
    return [name.removesuffix(_LIST) for name in services if name.endswith(_LIST)]


def _absolute(node: str) -> str:
    return node if node.startswith("/") else f"/{node}"


async def _names(node: Node, name: str, timeout_s: float) -> list[str]:
    return sorted((await _ask(node, name, "ListParameters", {}, timeout_s)).result.names)


async def _ask(
    node: Node, name: str, service: str, fields: dict[str, Any], timeout_s: float
) -> Any:
    """Call a service of a node's parameters."""
    from sfglab.messages import default_message, service_type

    type_ = service_type(f"rcl_interfaces/srv/{service}")
    request = default_message(type_.request, **fields)
    words = "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in service)[1:]
    return await call(node, type_.name, f"{_absolute(name)}/{words}", request, timeout_s)


async def _values(
    node: Node, name: str, parameters: list[str], timeout_s: float
) -> dict[str, tuple[str, Any]]:
    """Return kinds and values of parameters."""
    from sfglab.bus.parameters import plain_value

    response = await _ask(node, name, "GetParameters", {"names": parameters}, timeout_s)
    return dict(zip(parameters, map(plain_value, response.values), strict=False))


@param_app.command()
def get(
    node_name: _Node,
    name: _Name,
    hide_type: Annotated[bool, Option("--hide-type", help="Print the value alone.")] = False,
    as_json: Json = False,
    timeout: _Timeout = _SECONDS,
    domain: Domain = None,
    interface: Interface = None,
) -> None:
    """Print the value of a parameter.

    Example:
      sfglab param get /agent_decoder linger_s --domain 7
    """
    found = on_node((domain, interface), lambda node: _values(node, node_name, [name], timeout))
    kind, value = found.get(name, ("not set", None))
    if value is None:
        raise SfglabError(f"node {node_name}: parameter {name!r} is not set")
    if as_json:
        tell({"name": name, "type": kind, "value": value})
        return
    noun = "values are" if isinstance(value, list) else "value is"
    head = "" if hide_type else f"{kind.removesuffix(' array').capitalize()} {noun}: "
    typer.echo(f"{head}{value}")


@param_app.command("set")
def set_parameter(
    node_name: _Node,
    name: _Name,
    value: Annotated[str, Argument(help="Its value as YAML, e.g. 0.5 or '[a, b]'")],
    timeout: _Timeout = _SECONDS,
    domain: Domain = None,
    interface: Interface = None,
) -> None:
    """Set a parameter; ends with 1 if the node refuses, as nodes of sfglab do: theirs are given at the start.

    Example:
      sfglab param set /turtlesim background_r 120 --domain 7
    """
    from sfglab.bus.parameters import parameter_value
    from sfglab.messages import message_type

    parameter = message_type("rcl_interfaces/msg/Parameter")(
        name=name, value=parameter_value(_read(value))
    )
    given = {"parameters": [parameter]}
    response = on_node(
        (domain, interface), lambda node: _ask(node, node_name, "SetParameters", given, timeout)
    )
    if not response.results[0].successful:
        raise SfglabError(f"Setting parameter failed: {response.results[0].reason}")
    typer.echo("Set parameter successful")


def _read(text: str) -> Any:
    """Return the value that a text names: true or false, a number, text, or a list of one kind."""
    import yaml

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        value = text
    kinds = {type(one) for one in value} if isinstance(value, list) else {type(value)}
    whole = [value] if isinstance(value, int) else value if kinds == {int} else []
    if (
        len(kinds) != 1
        or not kinds <= {bool, int, float, str}
        or any(abs(one) >= 2**63 for one in whole)
    ):
        allowed = "true or false, a number of 64 bits, text, or a list of one of them"
        raise InvalidValueError("VALUE", text, allowed)
    return value


@param_app.command()
def dump(
    node_name: _Node,
    as_json: Json = False,
    timeout: _Timeout = _SECONDS,
    domain: Domain = None,
    interface: Interface = None,
) -> None:
    """Print all parameters of a node as a file of parameters.

    Example:
      sfglab param dump /agent_decoder --domain 7
    """
    from sfglab.messages.text import to_yaml

    async def ask(node: Node) -> dict[str, tuple[str, Any]]:
        return await _values(node, node_name, await _names(node, node_name, timeout), timeout)

    found = {name: value for name, (_, value) in on_node((domain, interface), ask).items()}
    if as_json:
        tell(found)
    else:
        typer.echo(to_yaml({_absolute(node_name): {"ros__parameters": _nested(found)}}), nl=False)


def _nested(values: dict[str, Any]) -> dict[str, Any]:
    """Return values whose names have dots as mappings in each other."""
    nested: dict[str, Any] = {}
    for name, value in values.items():
        *above, last = name.split(".")
        inner = nested
        for part in above:
            inner = inner.setdefault(part, {})
        inner[last] = value
    return nested
