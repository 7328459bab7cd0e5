"""Commands that look at topics, and publish: ``sfglab topic``, in the words of ``ros2 topic``."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

import sfglab.cli.buses as bus
from sfglab.cli.interfaces import Interfaces
from sfglab.errors import InvalidValueError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import Node

app = typer.Typer(help="Topics of a domain, in the words of ros2 topic.", no_args_is_help=True)
_Topic = Annotated[str, Argument(help="Name of the topic, e.g. /chatter")]
_Window = Annotated[
    int, Option("--window", "-w", min=2, help="How many messages are averaged over.")
]
_Duration = Annotated[
    float | None, Option(min=0.1, help="Seconds of messages until it ends; else until Ctrl-C.")
]
_HELP = "Begin when so many listen. [default: 1 with -1 and -t]"
_Wait = Annotated[int | None, Option("--wait-matching-subscriptions", "-w", min=0, help=_HELP)]
_REPORT_S = 1.0


@app.command("list")
def list_topics(
    show_types: bus.ShowTypes = False,
    count: bus.Count = False,
    hidden: Annotated[
        bool, Option("--include-hidden-topics", "-a", help="Consider names below _ as well.")
    ] = False,
    as_json: bus.Json = False,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    spin: bus.SpinTime = None,
) -> None:
    """List topics.

    Examples:
      sfglab topic list
      sfglab topic list -t --domain 7
    """
    found = bus.look((domain, interface), spin).topics(hidden=hidden)
    bus.list_names(found, show_types=show_types, count=count, as_json=as_json)


@app.command()
def echo(
    topic: _Topic,
    type_: Annotated[
        str | None, Argument(metavar="TYPE", help="Its type, if nobody has it yet.")
    ] = None,
    once: Annotated[bool, Option("--once", help="End after the first message.")] = False,
    field: Annotated[str, Option(help="Only this field, e.g. pose.position.x")] = "",
    full_length: Annotated[bool, Option("--full-length", "-f", help="Cut nothing.")] = False,
    truncate_length: Annotated[
        int, Option("--truncate-length", "-l", min=0, help="Where strings and arrays are cut.")
    ] = 128,
    no_arr: Annotated[bool, Option("--no-arr", help="Describe arrays only.")] = False,
    no_str: Annotated[bool, Option("--no-str", help="Describe strings only.")] = False,
    timeout: Annotated[
        float | None, Option(min=0.0, help="Seconds until the first message.")
    ] = None,
    as_json: Annotated[bool, Option("--json", help="A line of JSON a message, uncut.")] = False,
    reliability: bus.Reliability = None,
    durability: bus.Durability = None,
    depth: bus.Depth = None,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Print what is published, until Ctrl-C.

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
            bus.tell(values)
        else:
            typer.echo(f"{to_yaml(values)}---")

    async def listen(node: Node) -> None:
        name, publishers = await bus.type_of(node, topic, type_, wait=False)
        qos = bus.changed_qos(usual_qos(publishers), reliability, durability, depth)
        subscription = node.create_subscription(name, topic, qos=qos)
        show(await subscription.take(timeout))
        while not once:
            show(await subscription.take())

    bus.until_interrupted((domain, interface), listen)


@app.command()
def hz(
    topic: _Topic,
    window: _Window = 10000,
    duration: _Duration = None,
    as_json: bus.Json = False,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Print the average rate at which messages arrive, every second until Ctrl-C.

    Examples:
      sfglab topic hz /chatter
      sfglab topic hz /camera/image_raw --window 100 --domain 7
      sfglab topic hz /chatter --duration 5 --json
    """
    bus.until_interrupted(
        (domain, interface), lambda node: _measure_rate(node, topic, window, duration, as_json)
    )


async def _measure_rate(
    node: Node, topic: str, window: int, duration_s: float | None, as_json: bool
) -> None:
    """Print the rate of a topic, once per second in which messages arrived."""
    from sfglab.bus.listing import usual_qos
    from sfglab.bus.meters import Rate

    meter = Rate(window)
    name, publishers = await bus.type_of(node, topic, None, wait=True)
    subscription = node.create_subscription(name, topic, qos=usual_qos(publishers), raw=True)
    typer.echo(f"Subscribed to [{topic}]", err=as_json)
    due_ns = 0
    end_ns = 0.0
    while True:
        _, info = await subscription.take_with_info()
        now_ns = info.received_timestamp_ns
        meter.add(now_ns)
        if not due_ns:
            due_ns = now_ns + NS_PER_S
            end_ns = now_ns + (duration_s or float("inf")) * NS_PER_S
        if now_ns >= min(due_ns, end_ns) and (values := meter.values()):
            due_ns = now_ns + NS_PER_S
            if as_json:
                bus.tell(values)
            else:
                typer.echo(meter.text(values))
        if now_ns >= end_ns:
            return


@app.command()
def pub(
    topic: _Topic,
    type_: Annotated[str, Argument(metavar="TYPE", help="Type, e.g. std_msgs/msg/String")],
    values: Annotated[
        str, Argument(help="Fields as YAML, e.g. '{data: hello}'; now, auto: the time.")
    ] = "",
    rate: Annotated[float, Option("--rate", "-r", min=0.001, help="Messages a second.")] = 1.0,
    print_: Annotated[
        int, Option("--print", "-p", min=0, help="Print every n-th message; 0: none.")
    ] = 1,
    once: Annotated[bool, Option("--once", "-1", help="Publish one message and end.")] = False,
    times: Annotated[int, Option("--times", "-t", min=0, help="Publish so often and end.")] = 0,
    wait: _Wait = None,
    keep_alive: Annotated[
        float, Option(min=0.0, help="Seconds to stay after the last message.")
    ] = 0.1,
    reliability: bus.Reliability = None,
    durability: bus.Durability = None,
    depth: bus.Depth = None,
    domain: bus.Domain = None,
    interface: bus.Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Publish a message, again and again until Ctrl-C.

    Examples:
      sfglab topic pub /chatter std_msgs/msg/String '{data: hello}'
      sfglab topic pub --once /chatter std_msgs/msg/String '{data: hello}' --domain 7
      sfglab topic pub -r 10 /pose geometry_msgs/msg/PoseStamped '{header: auto, pose: {position: {x: 1}}}'
    """
    from sfglab.bus import BusTimeoutError
    from sfglab.messages.text import as_rclpy_shows, message_from_yaml
    from sfglab.qos import DEFAULT

    if once and times:
        raise InvalidValueError("--once", "--times as well", "one of them")
    name, count = bus.full_type(type_, "msg"), 1 if once else times
    qos = bus.changed_qos(DEFAULT, reliability, durability, depth)
    message_from_yaml(name, values, "VALUES")  # before anything is opened

    async def publish(node: Node) -> None:
        publisher = node.create_publisher(name, topic, qos)
        needed = wait if wait is not None else int(bool(count))
        while publisher.get_subscription_count() < needed:
            typer.echo(f"Waiting for at least {needed} matching subscription(s)...")
            with suppress(BusTimeoutError):
                await publisher.wait_for_subscriptions(needed, _REPORT_S)
        typer.echo("publisher: beginning loop")
        start_s, number = time.monotonic(), 0
        while not count or number < count:
            await asyncio.sleep(max(0.0, start_s + number / rate - time.monotonic()))
            message, number = message_from_yaml(name, values, "VALUES"), number + 1
            if print_ and number % print_ == 0:
                typer.echo(f"publishing #{number}: {as_rclpy_shows(message)}\n")
            publisher.publish(message)
        await asyncio.sleep(keep_alive)

    bus.until_interrupted((domain, interface), publish)
