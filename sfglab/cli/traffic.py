"""Traffic that ``qos`` and ``map`` read from a file, a log, or a domain that is observed for a time."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import typer

from sfglab.cli.buses import Place, observed_domain, on_node, unused

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.record import LogReader


@contextmanager
def opened(file: Path | None, place: Place, duration_s: float) -> Iterator[LogReader | Path]:
    """Open a log or bag, or without a file a recording of a domain; a path of any other file stays one."""
    from sfglab.record import LogReader
    from sfglab.record.bags import is_log

    domain = observed_domain(file, place[0])
    if file is not None:
        unused("with a file, because only a domain is observed", "duration", "interface")
    with TemporaryDirectory(prefix="sfglab-") as folder:
        if file is None:
            file = Path(folder) / "domain.mcap"
            typer.echo(f"listening to domain {domain} for {duration_s:g} s", err=True)
            _record(file, (domain, place[1]), duration_s)
        if is_log(file):
            with LogReader(file) as log:
                yield log
        else:
            yield file


def _record(path: Path, place: Place, duration_s: float) -> None:
    """Record a domain, without hidden topics and those that every node has."""
    from sfglab.bus.listing import is_hidden
    from sfglab.bus.recording import Recorder
    from sfglab.record import LogWriter

    def is_wanted(topic: str) -> bool:
        return topic not in {"/rosout", "/parameter_events"} and not is_hidden(topic)

    async def record(node: Node) -> None:
        recorder = Recorder(node, lambda: LogWriter(path), wanted=is_wanted, on_log=lambda _: None)
        with suppress(TimeoutError):
            async with asyncio.timeout(duration_s):
                await recorder.run()

    on_node(place, record)


def print_left_out(topics: Mapping[str, str]) -> None:
    """Print the topics of a log that are left out, with the reasons."""
    for topic, reason in topics.items():
        typer.echo(f"left out: {topic}: {reason}", err=True)
