"""Traffic that ``qos`` and ``map`` read from a file, a log, or a domain that is observed for a time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, TypeVar

import typer

from sfglab.cli.buses import Place, observed_domain, on_node, unused

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.record import LogReader

    T = TypeVar("T")
    Convert = Callable[[LogReader], tuple[T, Mapping[str, str]]]


def read_traffic(
    file: Path | None, place: Place, seconds: float, load: Callable[[Path], T], convert: Convert[T]
) -> T:
    """Return the content of a document, of a log or bag, or of the traffic of a domain.

    `load` reads a document. `convert` reads a log, and also returns the topics that it leaves out,
    with reasons.
    """
    domain = observed_domain(file, place[0])
    if file is not None:
        unused("with a file; it applies to a domain", "seconds", "interface")
        return _read(file, load, convert)
    with TemporaryDirectory(prefix="sfglab-") as folder:
        path = Path(folder) / "domain.mcap"
        typer.echo(f"listening to domain {domain} for {seconds:g} s", err=True)
        _record(path, (domain, place[1]), seconds)
        return _read(path, load, convert)


def _read(file: Path, load: Callable[[Path], T], convert: Convert[T]) -> T:
    from sfglab.record import LogReader
    from sfglab.record.bags import is_log

    if not is_log(file):
        return load(file)
    with LogReader(file) as log:
        found, left_out = convert(log)
    for topic, reason in left_out.items():
        typer.echo(f"left out: {topic}: {reason}", err=True)
    return found


def _record(path: Path, place: Place, seconds: float) -> None:
    """Record a domain, without hidden topics and those that every node has."""
    from sfglab.bus.listing import is_hidden
    from sfglab.bus.recording import Recorder
    from sfglab.record import LogWriter

    def is_wanted(topic: str) -> bool:
        return topic not in {"/rosout", "/parameter_events"} and not is_hidden(topic)

    async def record(node: Node) -> None:
        recorder = Recorder(node, lambda: LogWriter(path), wanted=is_wanted, told=lambda _: None)
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await recorder.run()

    on_node(place, record)
