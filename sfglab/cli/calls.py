"""Commands that ask: ``sfglab service`` and ``action``, in the words of ``ros2 service`` and ``action``."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

import sfglab.cli.buses as bus
from sfglab.cli.interfaces import Interfaces

if TYPE_CHECKING:
    from sfglab.bus import ClientGoalHandle, Node

service_app = typer.Typer(
    help="Services of a domain, in the words of ros2 service.", no_args_is_help=True
)
action_app = typer.Typer(
    help="Actions of a domain, in the words of ros2 action.", no_args_is_help=True
)


@service_app.command("list")
def list_services(
    show_types: bus.ShowTypes = False,
    count: bus.Count = False,
    hidden: bus.Hidden = False,
    as_json: bus.Json = False,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    spin: bus.SpinTime = None,
) -> None:
    """List services.

    Example:
      sfglab service list -t --domain 7
    """
    found = bus.look((domain, interface), spin).services(hidden=hidden)
    bus.list_names(found, show_types=show_types, count=count, as_json=as_json)


@service_app.command("call")
def call_service(
    service: Annotated[str, Argument(help="Name of the service, e.g. /enable")],
    type_: Annotated[str, Argument(metavar="TYPE", help="Type, e.g. std_srvs/srv/SetBool")],
    values: Annotated[str, Argument(help="The request's fields as YAML, e.g. '{data: true}'")] = "",
    timeout: bus.Timeout = None,
    as_json: bus.Json = False,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Call a service and print its response.

    A server on rmw_fastrtps is called by a ROS 2 that is sourced or that SFGLAB_ROS_PYTHON names.

    Examples:
      sfglab service call /enable std_srvs/srv/SetBool '{data: true}' --domain 7
      sfglab service call /go2/get_parameters rcl_interfaces/srv/GetParameters '{names: [rate]}' --timeout 5
    """
    from sfglab.messages import service_type, type_name
    from sfglab.messages.text import as_rclpy_shows, message_from_yaml, values_of

    kind = service_type(bus.full_type(type_, "srv"))
    request = message_from_yaml(type_name(kind.request), values, "VALUES")
    place = domain, interface
    response = bus.on_node(place, lambda node: bus.call(node, kind.name, service, request, timeout))
    if as_json:
        bus.tell(values_of(response))
    else:
        typer.echo(f"requester: making request: {as_rclpy_shows(request)}\n")
        typer.echo(f"response:\n{as_rclpy_shows(response)}\n")


@action_app.command("list")
def list_actions(
    show_types: bus.ShowTypes = False,
    count: bus.Count = False,
    as_json: bus.Json = False,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    spin: bus.SpinTime = None,
) -> None:
    """List actions.

    Example:
      sfglab action list -t --domain 7
    """
    found = bus.look((domain, interface), spin).actions()
    bus.list_names(found, show_types=show_types, count=count, as_json=as_json)


@action_app.command("send_goal", hidden=True)
@action_app.command("send-goal")
def send_goal(
    action: Annotated[str, Argument(help="Name of the action, e.g. /count")],
    type_: Annotated[
        str, Argument(metavar="TYPE", help="Type, e.g. example_interfaces/action/Fibonacci")
    ],
    values: Annotated[str, Argument(help="The goal's fields as YAML, e.g. '{order: 5}'")] = "",
    feedback: Annotated[
        bool, Option("--feedback", "-f", help="Print the goal's feedback.")
    ] = False,
    timeout: Annotated[
        float, Option(min=0.1, help="Seconds until the server accepts the goal.")
    ] = 30.0,
    as_json: Annotated[bool, Option("--json", help="Print JSON lines.")] = False,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Send an action a goal and wait for its end; Ctrl-C cancels the goal. Ends with 1 if it did not succeed.

    Examples:
      sfglab action send-goal /count example_interfaces/action/Fibonacci '{order: 5}' --domain 7
      sfglab action send-goal -f /go2/follow sfglab_interfaces/action/FollowTrajectory --domain 7
    """
    from sfglab.bus import GoalStatus
    from sfglab.messages import action_type, type_name
    from sfglab.messages.text import message_from_yaml, to_yaml, values_of

    kind = action_type(bus.full_type(type_, "action"))
    goal = message_from_yaml(type_name(kind.goal), values, "VALUES")
    ended: list[GoalStatus] = []

    def show(head: str, message: Any) -> None:
        if as_json:
            bus.tell({head.lower(): values_of(message)})
        else:
            typer.echo(f"{head}:\n    {to_yaml(values_of(message))}")

    async def send(node: Node) -> None:
        transport = await bus.transport_of(node, f"{action}/_action/send_goal", timeout)
        client = node.create_action_client(kind.name, action, transport=transport)
        if not as_json:
            show("Sending goal", goal)
        hear: Callable[[Any], None] | None = (
            (lambda message: show("Feedback", message)) if feedback else None
        )
        handle = await client.send_goal(goal, hear, timeout)
        if not as_json:
            typer.echo(f"Goal accepted with ID: {handle.goal_id.hex()}\n")
        result = await _result(handle)
        ended.append(result.status)
        show("Result", result.result)
        if as_json:
            bus.tell({"status": result.status.name})
        else:
            typer.echo(f"Goal finished with status: {result.status.name}")

    bus.until_interrupted((domain, interface), send)
    if ended != [GoalStatus.SUCCEEDED]:
        raise typer.Exit(1 if ended else 130)


async def _result(handle: ClientGoalHandle) -> Any:
    """Return how a goal ended; it is canceled if nobody waits any more."""
    from sfglab.bus import CancelCode

    try:
        return await handle.result()
    except asyncio.CancelledError:
        typer.echo("Canceling goal...", err=True)
        canceled = await handle.cancel_goal() is CancelCode.NONE
        typer.echo("Goal canceled." if canceled else "Failed to cancel goal", err=True)
        raise
