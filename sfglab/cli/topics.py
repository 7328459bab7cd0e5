"""Commands for topics and nodes, in the words of ROS 2: ``sfglab topic`` and ``sfglab node``."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from sfglab.cli.buses import look, print_json, say, until_interrupted
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.options import Count, Domain, Duration, Interface, Json, SpinTime
from sfglab.errors import SfglabError
from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import EndpointInfo, EndpointKind, Node

app = typer.Typer(help="List, print, measure and publish topics, like ros2 topic.")
node_app = typer.Typer(help="List the nodes of a domain, like ros2 node.")

_Topic = Annotated[str, Argument(help="Name of the topic, e.g. /chatter.")]
_Reliability = Annotated[
    Reliability | None,
    Option("--qos-reliability", help="QoS reliability of the publisher or subscription."),
]
_Durability = Annotated[
    Durability | None,
    Option("--qos-durability", help="QoS durability of the publisher or subscription."),
]
_Depth = Annotated[
    int | None, Option("--qos-depth", min=1, help="QoS history depth (KEEP_LAST), in messages.")
]
_TOPIC_S = 3.0  #: Time to discover a topic's first publisher, s.
_OTHERS_S = 0.3  #: Time to discover further publishers of the topic, s.
_LINGER_S = 0.1  #: Time to run after the last published message, s.
_REPORT_S = 1.0  #: Period of reports, s.


@node_app.command("list")
def list_nodes(
    hidden: Annotated[
        bool, Option("--all", "-a", help="Also list hidden nodes, whose names begin with _.")
    ] = False,
    count: Count = False,
    as_json: Json = False,
    domain: Domain = None,
    interface: Interface = None,
    spin_time: SpinTime = None,
) -> None:
    """List the nodes of a domain.

    Examples:
      sfglab node list
      sfglab node list --domain 7
    """
    from sfglab.bus.listing import is_hidden

    names = [node.full_name for node in look((domain, interface), spin_time).nodes]
    shown = [name for name in names if hidden or not is_hidden(name)]
    say(shown, str(len(shown)) if count else "\n".join(shown), as_json=as_json)


@app.command("list")
def list_topics(
    show_types: Annotated[bool, Option("--show-types", "-t", help="Also print the types.")] = False,
    count: Count = False,
    hidden: Annotated[
        bool,
        Option(
            "--include-hidden-topics",
            "-a",
            help="Also list hidden topics, which have a name part that begins with _.",
        ),
    ] = False,
    as_json: Json = False,
    domain: Domain = None,
    interface: Interface = None,
    spin_time: SpinTime = None,
) -> None:
    """List the topics of a domain.

    Examples:
      sfglab topic list
      sfglab topic list -t --domain 7
    """
    from sfglab.bus.listing import names_text

    found = look((domain, interface), spin_time).topics(hidden=hidden)
    text = str(len(found)) if count else names_text(found, show_types=show_types)
    values = [{"name": name, "types": types} for name, types in found.items()]
    say(values, text, as_json=as_json)


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
    truncate_length: Annotated[
        int,
        Option("--truncate-length", "-l", min=0, help="Printed length of strings and arrays."),
    ] = 128,
    no_arr: Annotated[
        bool, Option("--no-arr", help="Print types and lengths of arrays only.")
    ] = False,
    no_str: Annotated[bool, Option("--no-str", help="Print lengths of strings only.")] = False,
    timeout: Annotated[
        float | None,
        Option(min=0.0, help="Time to wait for the first message, s. [default: indefinitely]"),
    ] = None,
    as_json: Json = False,
    reliability: _Reliability = None,
    durability: _Durability = None,
    depth: _Depth = None,
    domain: Domain = None,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Print the messages of a topic until Ctrl-C.

    The requested QoS matches all publishers unless options set it. With --json each message is one
    line and complete.

    Examples:
      sfglab topic echo /chatter
      sfglab topic echo /chatter --once --domain 7
      sfglab topic echo /odom --field pose.pose.position
      sfglab topic echo /chatter --json | jq .data
    """
    from sfglab.bus.listing import usual_qos
    from sfglab.messages.text import Style, to_yaml, value_at, values_of

    cut = None if full_length or as_json else truncate_length
    style = Style(truncate_length=cut, no_arr=no_arr, no_str=no_str)

    def show(message: Any) -> None:
        values = value_at(values_of(message, style), field, "--field")
        if as_json:
            print_json(values)
        else:
            typer.echo(f"{to_yaml(values)}---")

    async def listen(node: Node) -> None:
        publishers = await _publishers(node, topic)
        name = _full_type(type_) if type_ else await _type_of(node, topic)
        qos = _changed(usual_qos(publishers), reliability, durability, depth)
        subscription = node.create_subscription(name, topic, qos=qos)
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
    domain: Domain = None,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Print the average rate of a topic every second and at the end, until Ctrl-C.

    Examples:
      sfglab topic hz /chatter
      sfglab topic hz /camera/image_raw --window 100 --domain 7
      sfglab topic hz /chatter --duration 5 --json
    """
    from sfglab.bus.listing import usual_qos
    from sfglab.bus.meters import Rate

    meter = Rate(window)

    async def measure(node: Node) -> None:
        publishers = await _publishers(node, topic)
        if not publishers:
            typer.echo(f"WARNING: topic [{topic}] does not appear to be published yet", err=True)
        while not publishers:
            publishers = await _publishers(node, topic)
        name = await _type_of(node, topic)
        subscription = node.create_subscription(name, topic, qos=usual_qos(publishers), raw=True)
        typer.echo(f"Subscribed to [{topic}]", err=as_json)
        due_ns = 0
        try:
            while True:
                _, info = await subscription.take_with_info()
                now_ns = info.received_timestamp_ns
                meter.add(now_ns)
                if not due_ns:
                    due_ns = now_ns + NS_PER_S
                if now_ns >= due_ns:
                    due_ns = now_ns + NS_PER_S
                    print_rate()
        finally:
            print_rate()

    def print_rate() -> None:
        values = meter.values()
        if values is not None:
            say(values, meter.text(values), as_json=as_json)

    until_interrupted((domain, interface), measure, duration_s=duration)


@app.command()
def pub(
    topic: _Topic,
    type_: Annotated[str, Argument(metavar="TYPE", help="Type, e.g. std_msgs/msg/String.")],
    values: Annotated[
        str,
        Argument(
            help="Fields as YAML, e.g. '{data: hello}'; now (a stamp) and auto (a header) give the time."
        ),
    ] = "",
    rate: Annotated[float, Option("--rate", "-r", min=0.001, help="Rate, Hz.")] = 1.0,
    once: Annotated[bool, Option("--once", "-1", help="Publish one message and end.")] = False,
    times: Annotated[
        int, Option("--times", "-t", min=0, help="Number of messages to publish; 0: no limit.")
    ] = 0,
    wait: Annotated[
        int | None,
        Option(
            "--wait-matching-subscriptions",
            "-w",
            min=0,
            help="Wait for this many matching subscriptions first. "
            "[default: 1 with --once or --times, otherwise 0]",
        ),
    ] = None,
    reliability: _Reliability = None,
    durability: _Durability = None,
    depth: _Depth = None,
    domain: Domain = None,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Publish a message repeatedly until Ctrl-C.

    The offered QoS is ROS 2's default unless options set it.

    Examples:
      sfglab topic pub /chatter std_msgs/msg/String '{data: hello}'
      sfglab topic pub --once /chatter std_msgs/msg/String '{data: hello}' --domain 7
      sfglab topic pub -r 10 /pose geometry_msgs/msg/PoseStamped '{header: auto, pose: {position: {x: 1}}}'
    """
    from sfglab.bus import BusTimeoutError
    from sfglab.messages.text import message_from_yaml, to_yaml, values_of

    if once and times:
        raise SfglabError("--once and --times exclude each other: give one of them")
    count = 1 if once else times
    needed = min(count, 1) if wait is None else wait
    name = _full_type(type_)
    qos = _changed(DEFAULT, reliability, durability, depth)
    message_from_yaml(name, values, "VALUES")  # An error is to appear before the node.

    async def publish(node: Node) -> None:
        publisher = node.create_publisher(name, topic, qos)
        while publisher.get_subscription_count() < needed:
            typer.echo(f"Waiting for at least {needed} matching subscription(s)...")
            with suppress(BusTimeoutError):
                await publisher.wait_for_subscriptions(needed, _REPORT_S)
        typer.echo("publisher: beginning loop")
        start_s = time.monotonic()
        number = 0
        while not count or number < count:
            due_s = start_s + number / rate
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            message = message_from_yaml(name, values, "VALUES")
            number += 1
            typer.echo(f"publishing #{number}:\n{to_yaml(values_of(message))}")
            publisher.publish(message)
        await asyncio.sleep(_LINGER_S)

    until_interrupted((domain, interface), publish)


def _changed(
    qos: QoSProfile,
    reliability: Reliability | None,
    durability: Durability | None,
    depth: int | None,
) -> QoSProfile:
    """Return a QoS with the policies that the command line sets."""
    if reliability:
        qos = replace(qos, reliability=reliability)
    if durability:
        qos = replace(qos, durability=durability)
    if depth:
        qos = replace(qos, history=History.KEEP_LAST, depth=depth)
    return qos


def _full_type(name: str) -> str:
    """Return the full name of a known message type; the part msg may be left out."""
    from sfglab.messages import type_name

    package, _, rest = name.partition("/")
    return type_name(name if not rest or "/" in rest else f"{package}/msg/{rest}")


def _ends(node: Node, topic: str, kind: EndpointKind) -> list[EndpointInfo]:
    from sfglab.bus.listing import view

    return [end for end in view(node).ends(topic, kind) if end.transport == "dds"]


async def _publishers(node: Node, topic: str) -> list[EndpointInfo]:
    """Return the publishers of a topic after a time in which they are discovered."""
    from sfglab.bus import EndpointKind

    def is_published() -> bool:
        return bool(_ends(node, topic, EndpointKind.PUBLISHER))

    if await node.graph.wait_for(is_published, _TOPIC_S):
        await asyncio.sleep(_OTHERS_S)
    return _ends(node, topic, EndpointKind.PUBLISHER)


async def _type_of(node: Node, topic: str) -> str:
    """Return the type of a topic.

    Raises:
        SfglabError: There is no such topic, or it has several types.
    """
    from sfglab.bus.listing import one_of, settled, view

    topics = view(node).topics(hidden=True)
    if topic not in topics:
        seen = await settled(node)
        topics = seen.topics(hidden=True)
        one_of(topics, topic, "topic")
    names = topics[topic]
    if len(names) > 1:
        several = ", ".join(names)
        raise SfglabError(f"topic {topic} has several types: {several}; echo takes one as TYPE")
    return _full_type(names[0])
