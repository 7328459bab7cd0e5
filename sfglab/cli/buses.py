"""Habits of all commands: options for a DDS domain, a node while they run, what is said and what is refused."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable, Coroutine, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer import Option

from sfglab.component import run, run_until_interrupted
from sfglab.domains import MAX_DOMAIN, VARIABLE
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import to_json
from sfglab.files import write_files

if TYPE_CHECKING:
    from sfglab.bus import EndpointInfo, Node
    from sfglab.bus.listing import View
    from sfglab.qos import QoSProfile

T = TypeVar("T")


def domain_option(text: str, default: str = f"{VARIABLE}, else 0") -> Any:
    """Return an option for a domain, whose default the command knows."""
    return Option(min=0, max=MAX_DOMAIN, help=f"{text} [default: {default}]")


Domain = Annotated[int | None, domain_option("DDS domain.")]
Interface = Annotated[str | None, Option(help="Network interface; lo stays inside.")]
SpinTime = Annotated[
    float | None,
    Option(
        "--spin-time", min=0.0, help="Seconds to wait for discovery. [default: until all is quiet]"
    ),
]
Json = Annotated[bool, Option("--json", help="Print JSON.")]
ShowTypes = Annotated[bool, Option("--show-types", "-t", help="Additionally show the type.")]
Count = Annotated[bool, Option("--count", "-c", help="Only display how many there are.")]
Reliability = Annotated[str | None, Option("--qos-reliability", help="reliable or best_effort.")]
Durability = Annotated[str | None, Option("--qos-durability", help="volatile or transient_local.")]
Depth = Annotated[int | None, Option("--qos-depth", min=1, help="How many messages are kept.")]
Place = tuple[int | None, str | None]  #: A domain and an interface.
_TOPIC_S = 3.0  #: Time to discover a topic's first publisher, s.
_OTHERS_S = 0.3  #: Time to discover further publishers of the topic, s.


def on_node(place: Place, body: Callable[[Node], Coroutine[Any, Any, T]], name: str = "") -> T:
    """Run something on a node, without a name on one that ROS 2's tools hide, and return what it returns."""

    async def main() -> T:
        from sfglab.bus import Node

        async with Node(
            name or f"_sfglab_{os.getpid()}", domain_id=place[0], interface=place[1]
        ) as node:
            return await body(node)

    return run(main())


def until_interrupted(
    place: Place,
    body: Callable[[Node], Coroutine[Any, Any, None]],
    name: str = "",
    *,
    err: bool = True,
) -> None:
    """Do as `on_node` until it ends, or until Ctrl-C, which is one line, of errors or not."""
    if on_node(place, lambda node: run_until_interrupted(body(node)), name):
        typer.echo("ended", err=err)


def look(place: Place, spin_s: float | None) -> View:
    """Return what is on a domain."""
    from sfglab.bus.listing import settled

    return on_node(place, lambda node: settled(node, spin_s))


def say(values: Any, text: Callable[[Any], str], *, as_json: bool) -> None:
    """Print values as JSON, or as their text."""
    if as_json:
        tell(values)
    else:
        typer.echo(text(values).removesuffix("\n"))


def tell(values: Any) -> None:
    """Print values as a line of JSON, at once."""
    typer.echo(json.dumps(to_json(values), ensure_ascii=False, default=str))


def list_names(
    found: dict[str, tuple[str, ...]], *, show_types: bool, count: bool, as_json: bool
) -> None:
    """Print names with their types as ROS 2's lists do."""
    from sfglab.bus.listing import names_text

    if as_json:
        tell([{"name": name, "types": types} for name, types in found.items()])
    else:
        typer.echo(
            f"{len(found)}\n" if count else names_text(found, show_types=show_types), nl=False
        )


def changed_qos(
    qos: QoSProfile, reliability: str | None, durability: str | None, depth: int | None
) -> QoSProfile:
    """Return a profile with what the command line says.

    Raises:
        InvalidValueError: It says what there is not.
    """
    from dataclasses import replace

    from sfglab import qos as policies

    if reliability is not None:
        qos = replace(
            qos, reliability=_choice(policies.Reliability, reliability, "--qos-reliability")
        )
    if durability is not None:
        qos = replace(qos, durability=_choice(policies.Durability, durability, "--qos-durability"))
    return qos if depth is None else replace(qos, history=policies.History.KEEP_LAST, depth=depth)


def _choice(kind: Any, given: str, option: str) -> Any:
    if given not in (allowed := [one.value for one in kind]):
        raise InvalidValueError(option, given, " or ".join(allowed))
    return kind(given)


def full_type(name: str, kind: str) -> str:
    """Return a type's full name; its kind, such as msg, may be left out."""
    package, slash, rest = name.partition("/")
    return f"{package}/{kind}/{rest}" if slash and "/" not in rest else name


async def type_of(
    node: Node, topic: str, given: str | None, *, wait: bool
) -> tuple[str, list[EndpointInfo]]:
    """Return a topic's type and publishers, once there are any or, if a type is given, after a look around.

    Raises:
        InvalidValueError: There is no such topic, and it is not to be waited for, or it has several types.
    """
    from sfglab.bus import EndpointKind
    from sfglab.bus.listing import one_of, settled, view
    from sfglab.messages import type_name

    def ends(kind: EndpointKind = EndpointKind.PUBLISHER) -> list[EndpointInfo]:
        return [e for e in view(node).ends(topic, kind) if e.transport == "dds"]

    name, known = type_name(full_type(given, "msg")) if given else "", set[str]()
    if await node.graph.wait_for(lambda: bool(ends()), _TOPIC_S):
        await asyncio.sleep(_OTHERS_S)
    elif not name and not (known := {e.type for e in ends(EndpointKind.SUBSCRIPTION)}):
        if not wait:
            one_of((await settled(node)).topics(hidden=True), topic, "topic")
        typer.echo(f"WARNING: topic [{topic}] does not appear to be published yet", err=True)
        while not await node.graph.wait_for(lambda: bool(ends()), 60.0):
            pass
    return name or type_name(_only({e.type for e in ends()} or known, topic)), ends()


def _only(types: Iterable[str], topic: str) -> str:
    first, *more = sorted(types)
    if more:
        raise InvalidValueError(
            f"topic {topic}, type", None, f"one of {', '.join((first, *more))}, to be said"
        )
    return first


def put_text(text: str, path: Path | None, folder: Path | None = None) -> None:
    """Write a text into a file as `put` does, or onto the terminal without one."""
    if path is None:
        typer.echo(text, nl=False)
    else:
        put({path: text}, folder)


def put(files: Mapping[Path, str | bytes], folder: Path | None = None) -> None:
    """Write files, all or none, and say which; below a folder, which is made, if one is given."""
    write_files(files, folder=folder)
    for path in files:
        typer.echo(path if folder is None else folder / path)


def say_left_out(left_out: Mapping[str, str]) -> None:
    """Say of each topic that is left out why."""
    for topic, why in left_out.items():
        typer.echo(f"left out: {topic}: {why}", err=True)


def unused(why: str, *names: str) -> None:
    """Refuse options, by their parameters' names, that were given where nothing looks at them, and say why."""
    # typer brings a click of its own, or takes the installed one
    click = import_module(typer.Context.__mro__[1].__module__.partition(".core")[0] + ".globals")
    context = click.get_current_context()
    options = {parameter.name: max(parameter.opts, key=len) for parameter in context.command.params}
    source = context.get_parameter_source
    if given := [
        options[name] for name in names if getattr(source(name), "name", "") == "COMMANDLINE"
    ]:
        raise SfglabError(f"{' and '.join(given)}: given {why}")
