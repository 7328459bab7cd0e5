"""Commands for topics and nodes, in the words of ROS 2: ``sfglab topic`` and ``sfglab node``."""

from __future__ import annotations

import asyncio
import itertools
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from sfglab.cli.buses import look, print_json, say, until_interrupted
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.options import Domain, Duration, Interface, Json, SpinTime
from sfglab.errors import SfglabError
from sfglab.qos import DEFAULT, Durability
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import EndpointInfo, Node, Subscription

app = typer.Typer(
    help="""List, print, measure and publish topics, like ros2 topic.

Example:
  sfglab topic list --domain 7"""
)
node_app = typer.Typer(
    help="""List the nodes of a domain, like ros2 node.

Example:
  sfglab node list --domain 7"""
)

_Topic = Annotated[str, Argument(metavar="TOPIC", help="Name of the topic, e.g. /chatter.")]
_TOPIC_S = 5.0  #: Time to discover a topic's first publisher, s.
_OTHERS_S = 0.3  #: Time to discover further publishers of the topic, s.
_LINGER_S = 0.1  #: Time to run after the last published message, s.
_REPORT_S = 1.0  #: Period of reports, s.
_SHOWN = 128  #: Printed length of a string or array, in characters or elements.


@node_app.command("list")
def list_nodes(
    as_json: Json = False,
    domain: Domain = 0,
    interface: Interface = None,
    spin_time: SpinTime = None,
) -> None:
    """List the nodes of a domain. Nodes whose names begin with _ are hidden.

    Examples:
      sfglab node list
      sfglab node list --domain 7
    """
    from sfglab.bus.listing import is_hidden

    names = [node.full_name for node in look((domain, interface), spin_time).nodes]
    shown = [name for name in names if not is_hidden(name)]
    say(shown, "\n".join(shown), as_json=as_json)


@app.command("list")
def list_topics(
    show_types: Annotated[bool, Option("--show-types", "-t", help="Also print the types.")] = False,
    as_json: Json = False,
    domain: Domain = 0,
    interface: Interface = None,
    spin_time: SpinTime = None,
) -> None:
    """List the topics of a domain. Topics with a part that begins with _ are hidden.

    Examples:
      sfglab topic list
      sfglab topic list -t --domain 7
    """
    from sfglab.bus.listing import names_text

    found = look((domain, interface), spin_time).topics()
    values = [{"name": name, "types": types} for name, types in found.items()]
    say(values, names_text(found, show_types=show_types), as_json=as_json)


@app.command()
def echo(
    topic: _Topic,
    type_: Annotated[
        str | None,
        Argument(metavar="TYPE", help="Type of the topic. [default: its publishers' type]"),
    ] = None,
    once: Annotated[bool, Option("--once", help="End after the first message.")] = False,
    field: Annotated[str, Option(help="Print this field only, e.g. pose.position.x.")] = "",
    full_length: Annotated[
        bool, Option("--full-length", "-f", help="Print strings and arrays in full.")
    ] = False,
    timeout: Annotated[
        float | None,
        Option(min=0.0, help="Time to wait for the first message, s. [default: indefinitely]"),
    ] = None,
    as_json: Json = False,
    domain: Domain = 0,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Print the messages of a topic until Ctrl-C.

    The requested QoS matches all publishers. Long strings and arrays are cut, except with
    --full-length or --json. With --json each message is one line.

    Examples:
      sfglab topic echo /chatter
      sfglab topic echo /chatter --once --domain 7
      sfglab topic echo /odom --field pose.pose.position
      sfglab topic echo /chatter --json | jq .data
    """
    from sfglab.messages.text import to_yaml, value_at, values_of

    most = None if full_length or as_json else _SHOWN

    def show(message: Any) -> None:
        values = value_at(values_of(message, most), field, "--field")
        if as_json:
            print_json(values)
        else:
            typer.echo(f"{to_yaml(values)}---")

    async def listen(node: Node) -> None:
        subscription = await _subscribed(node, topic, type_, "; give one of them as TYPE")
        show(await subscription.take(timeout))
        while not once:
            show(await subscription.take())

    until_interrupted((domain, interface), listen)


@app.command()
def hz(
    topic: _Topic,
    window: Annotated[
        int, Option("--window", "-w", min=2, help="Number of messages to average over.")
    ] = 10000,
    duration: Duration = None,
    as_json: Json = False,
    domain: Domain = 0,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Print the average rate of a topic every second and at the end, until Ctrl-C.

    Examples:
      sfglab topic hz /chatter
      sfglab topic hz /camera/image_raw --window 100 --domain 7
      sfglab topic hz /chatter --duration 5 --json
    """
    from sfglab.bus.meters import Rate

    meter = Rate(window)

    async def measure(node: Node) -> None:
        if not await _is_published(node, topic, _REPORT_S):
            typer.echo(f"WARNING: topic [{topic}] does not appear to be published yet", err=True)
        while not await _is_published(node, topic, _TOPIC_S):
            pass
        subscription = await _subscribed(node, topic, raw=True)
        typer.echo(f"Subscribed to [{topic}]", err=as_json)
        printed_ns = 0
        try:
            while True:
                _, info = await subscription.take_with_info()
                now_ns = info.received_timestamp_ns
                meter.add(now_ns)
                if now_ns >= printed_ns + NS_PER_S:
                    printed_ns = now_ns
                    print_rate()
        finally:
            print_rate()

    def print_rate() -> None:
        values = meter.values()
        if values is not None:  # after the first message there is no rate yet
            say(values, meter.text(values), as_json=as_json)

    until_interrupted((domain, interface), measure, duration_s=duration)


@app.command()
def pub(
    topic: _Topic,
    type_: Annotated[str, Argument(metavar="TYPE", help="Type, e.g. std_msgs/msg/String.")],
    values: Annotated[
        str,
        Argument(
            metavar="VALUES",
            help="Fields as YAML, e.g. '{data: hello}'. For a stamp, now is the current time; for a header, "
            "auto sets it. [default: the fields' defaults]",
        ),
    ] = "",
    rate: Annotated[
        float, Option("--rate", "-r", min=0.001, help="Rate of the messages, Hz.")
    ] = 1.0,
    once: Annotated[
        bool,
        Option("--once", "-1", help="Publish one message once a subscription matches, and end."),
    ] = False,
    durability: Annotated[
        Durability, Option("--qos-durability", help="Offered durability.")
    ] = DEFAULT.durability,
    domain: Domain = 0,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Publish a message repeatedly until Ctrl-C.

    Examples:
      sfglab topic pub /chatter std_msgs/msg/String '{data: hello}'
      sfglab topic pub --once /chatter std_msgs/msg/String '{data: hello}' --domain 7
      sfglab topic pub -r 10 /pose geometry_msgs/msg/PoseStamped '{header: auto, pose: {position: {x: 1}}}'
    """
    from sfglab.bus import BusTimeoutError
    from sfglab.messages.text import message_from_yaml, to_yaml, values_of

    name = _full_type(type_)
    qos = replace(DEFAULT, durability=durability)
    message_from_yaml(name, values, "VALUES")  # An error is to appear before the node.

    async def publish(node: Node) -> None:
        publisher = node.create_publisher(name, topic, qos)
        while once and not publisher.get_subscription_count():
            typer.echo("Waiting for at least 1 matching subscription(s)...")
            with suppress(BusTimeoutError):
                await publisher.wait_for_subscriptions(1, _REPORT_S)
        typer.echo("publisher: beginning loop")
        start_s = time.monotonic()
        for number in itertools.count(1):
            message = message_from_yaml(name, values, "VALUES")
            typer.echo(f"publishing #{number}:\n{to_yaml(values_of(message))}")
            publisher.publish(message)
            if once:
                await asyncio.sleep(_LINGER_S)
                return
            due_s = start_s + number / rate
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))

    until_interrupted((domain, interface), publish)


def _full_type(name: str) -> str:
    """Return the full name of a known message type; the part msg may be left out."""
    from sfglab.messages import type_name

    package, _, rest = name.partition("/")
    return type_name(name if not rest or "/" in rest else f"{package}/msg/{rest}")


def _publishers(node: Node, topic: str) -> list[EndpointInfo]:
    """Return the publishers of a topic that are discovered."""
    from sfglab.bus import EndpointKind
    from sfglab.bus.listing import view

    ends = view(node).ends(topic, EndpointKind.PUBLISHER)
    return [end for end in ends if end.transport == "dds"]


async def _is_published(node: Node, topic: str, timeout_s: float) -> bool:
    return await node.graph.wait_for(lambda: bool(_publishers(node, topic)), timeout_s)


async def _subscribed(
    node: Node, topic: str, type_name: str | None = None, advice: str = "", *, raw: bool = False
) -> Subscription:
    """Return a subscription to a topic with the QoS that matches all publishers.

    It waits until publishers are discovered. Without `type_name`, it takes their type; `advice` ends the error
    for several types.

    Raises:
        SfglabError: Without `type_name`: there is no such topic, or it has several types.
    """
    from sfglab.bus.listing import one_of, usual_qos, view

    if await _is_published(node, topic, _TOPIC_S):
        await asyncio.sleep(_OTHERS_S)
    if not type_name:
        topics = view(node).topics(hidden=True)
        type_name, *others = topics[one_of(topics, topic, "topic")]
        if others:
            names = ", ".join([type_name, *others])
            raise SfglabError(f"topic {topic} has several types: {names}{advice}")
    qos = usual_qos(_publishers(node, topic))
    return node.create_subscription(_full_type(type_name), topic, qos=qos, raw=raw)
