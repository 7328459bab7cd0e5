"""Parts of several commands: a node while a command runs, printed values, written files, refused options."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable, Coroutine, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from sfglab.component import run, run_until_interrupted
from sfglab.domains import VARIABLE, usual_domain_id
from sfglab.errors import SfglabError
from sfglab.fields import to_json
from sfglab.files import write_files

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.bus.listing import View

T = TypeVar("T")

Place = tuple[int | None, str | None]  #: A domain and an interface.


def on_node(place: Place, body: Callable[[Node], Coroutine[Any, Any, T]], name: str = "") -> T:
    """Run a coroutine function on a node, and return its result.

    Args:
        place: DDS domain and network interface of the node; None for the defaults.
        body: Function that is given the node.
        name: Name of the node; without a name, the node gets one that ROS 2's tools hide.
    """
    domain, interface = place

    async def main() -> T:
        from sfglab.bus import Node

        hidden = f"_sfglab_{os.getpid()}"
        async with Node(name or hidden, domain_id=domain, interface=interface) as node:
            return await body(node)

    return run(main())


def until_interrupted(
    place: Place,
    body: Callable[[Node], Coroutine[Any, Any, None]],
    name: str = "",
    *,
    duration_s: float | None = None,
) -> None:
    """Run a coroutine function on a node as `on_node` does, until it ends, after `duration_s` seconds, or on Ctrl-C."""

    async def limited(node: Node) -> None:
        limit = asyncio.timeout(duration_s)
        try:
            async with limit:
                await body(node)
        except TimeoutError:
            if not limit.expired():
                raise

    if on_node(place, lambda node: run_until_interrupted(limited(node)), name):
        typer.echo("ended", err=True)


def look(place: Place, spin_s: float | None) -> View:
    """Return the topics and nodes of a domain after `spin_s` seconds; with None once the graph no longer changes."""
    from sfglab.bus.listing import settled

    return on_node(place, lambda node: settled(node, spin_s))


def observed_domain(file: Path | None, domain: int | None) -> int | None:
    """Return the domain that a command observes; None if it reads a file.

    Raises:
        SfglabError: Both a file and a domain are given.
    """
    if file is not None and domain is not None:
        raise SfglabError("a file and --domain exclude each other; give one of them")
    if file is not None or domain is not None:
        return domain
    if not os.environ.get(VARIABLE):
        raise SfglabError(f"nothing to read; give a file, --domain or {VARIABLE}")
    return usual_domain_id()


def say(values: Any, text: str, *, as_json: bool) -> None:
    """Print values as JSON, or a text about them unless it is empty."""
    if as_json:
        print_json(values)
    elif text:
        typer.echo(text.removesuffix("\n"))


def print_json(values: Any) -> None:
    """Print values as one line of JSON; NaN and infinite numbers, which JSON does not have, are null."""
    text = json.dumps(to_json(values), default=str)
    plain = json.loads(text, parse_constant=lambda _: None)
    typer.echo(json.dumps(plain, ensure_ascii=False, allow_nan=False))


def write_text(text: str, path: Path | None, folder: Path | None = None) -> None:
    """Write a text into a file as `write` does; if the path is None, print it."""
    if path is None:
        typer.echo(text, nl=False)
    else:
        write({path: text}, folder)


def write(
    files: Mapping[Path, str | bytes], folder: Path | None = None, *, err: bool = False
) -> None:
    """Write all files or none, below a folder if one is given, and print their paths.

    The paths go to standard output, with `err` to standard error.
    """
    write_files(files, folder=folder)
    for path in files:
        typer.echo(path if folder is None else folder / path, err=err)


def unused(why: str, *names: str) -> None:
    """Refuse options that have no effect in this call of the command.

    Args:
        why: Reason why they have no effect.
        names: Names of the parameters; only those that the user gave are refused.

    Raises:
        SfglabError: The user gave one of the options.
    """
    # typer brings its own click or uses the installed one.
    package = typer.Context.__mro__[1].__module__.removesuffix(".core")
    context = import_module(f"{package}.globals").get_current_context()
    given = []
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name)
        if parameter.name in names and source.name == "COMMANDLINE":
            given.append(max(parameter.opts, key=len))
    if given:
        raise SfglabError(f"{' and '.join(given)}: no effect {why}; leave it out")
