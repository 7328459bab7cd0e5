"""Commands for logs and bags: ``sfglab log``, in the words of ``ros2 bag``, and what a log holds."""

from __future__ import annotations

import asyncio
import json
import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

from sfglab.cli.buses import Domain, Interface, Json, Place, on_node, tell, until_interrupted
from sfglab.cli.interfaces import Interfaces
from sfglab.errors import InvalidValueError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.record import LogReader


class _Log(TyperGroup):
    """A group whose command is `show` where the first word is none of its commands."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, the command and its arguments."""
        return super().resolve_command(ctx, args if args[0] in self.commands else ["show", *args])


app = typer.Typer(
    cls=_Log,
    help="""Logs and bags, in the words of ros2 bag; alone, what a log holds or which runs there are.

Examples:

  sfglab log

  sfglab log data/reference/cooperation.mcap""",
)
_Log_ = Annotated[
    Path, Argument(metavar="LOG", help="An MCAP file, a rosbag2 folder or its .db3 file.")
]
_Topics = Annotated[list[str] | None, Option("--topics", help="Only this topic; may be repeated.")]
_Regex = Annotated[str | None, Option("--regex", "-e", help="Only topics in which this is found.")]
_Exclude = Annotated[
    str | None, Option("--exclude-regex", "-x", help="No topics in which this is found.")
]
_Start = Annotated[float, Option("--start-offset", min=0.0, help="Seconds to leave out first.")]
_Duration = Annotated[float | None, Option(min=0.0, help="Seconds of the log.")]


@app.callback(invoke_without_command=True)
def log(context: typer.Context) -> None:
    """List runs and which of them speak for the claims, unless a command follows."""
    from sfglab.cli.experiments import list_runs

    if context.invoked_subcommand is None:
        list_runs()


@app.command(hidden=True)
def show(path: _Log_, as_json: Json = False) -> None:
    """List what a log holds: topics, rates, sizes, metadata.

    Example:
      sfglab log data/reference/cooperation.mcap
    """
    from sfglab.record import LogReader
    from sfglab.tables import text_table

    with LogReader(path) as reader:
        metadata = {name: reader.metadata(name) for name in reader.metadata_names}
        head, *rows = reader.overview()
        if as_json:
            tell(
                {
                    "topics": [dict(zip(head, row, strict=True)) for row in rows],
                    "metadata": metadata,
                }
            )
            return
        typer.echo(text_table([head, *rows]))
        for name, values in metadata.items():
            typer.echo(f"metadata  {name}: {json.dumps(values)}")
        if reader.truncated:
            typer.echo("the log was cut off; what stands here is all that is in it")


@app.command()
def info(path: _Log_, as_json: Json = False) -> None:
    """Print what is in a log as ros2 bag info does.

    Example:
      sfglab log info data/reference/mocap.mcap
    """
    from sfglab.record import LogReader

    with LogReader(path) as reader:
        values = _info(reader)
    if as_json:
        tell(values)
        return
    times = {name: values[f"{name}_ns"] for name in ("start", "end")}
    said = {name: f"{_date(ns)} ({_seconds(ns)})" for name, ns in times.items()}
    line = "Topic: {name} | Type: {type} | Count: {count} | Serialization Format: {encoding}"
    topics = [line.format_map(topic) for topic in values["topics"]]
    indent = "\n" + " " * 19
    typer.echo(
        f"\nFiles:             {indent.join(values['files'])}\n"
        f"Bag size:          {_size(values['size_bytes'])}\n"
        f"Storage id:        {values['storage']}\n"
        f"Duration:          {_seconds(values['end_ns'] - values['start_ns'])}s\n"
        f"Start:             {said['start']}\n"
        f"End:               {said['end']}\n"
        f"Messages:          {values['messages']}\n"
        f"Topic information: {indent.join(topics)}\n"
    )


def _info(reader: LogReader) -> dict[str, Any]:
    start_ns, end_ns = reader.span_ns
    topics = [
        {"name": name, "type": topic.type_name, "count": topic.count, "encoding": topic.encoding}
        for name, topic in reader.topics.items()
    ]
    suffixes = {suffix for file in reader.files for suffix in file.suffixes}
    storages = {".db3": "sqlite3", ".mcap": "mcap"}
    return {
        "files": [file.name for file in reader.files],
        "size_bytes": sum(file.stat().st_size for file in reader.files),
        "storage": ", ".join(name for suffix, name in storages.items() if suffix in suffixes),
        "start_ns": start_ns,
        "end_ns": end_ns,
        "messages": sum(topic["count"] for topic in topics),
        "topics": topics,
    }


def _seconds(time_ns: int) -> str:
    return f"{time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}"


def _date(time_ns: int) -> str:
    when = datetime.fromtimestamp(time_ns // NS_PER_S, UTC).astimezone()
    return f"{when:%b} {when.day:2d} {when:%Y %H:%M:%S}.{time_ns % NS_PER_S:09d}"


def _size(size_bytes: float) -> str:
    power = next(p for p in range(5) if size_bytes < 1024 ** (p + 1) or p == 4)
    return (
        f"{size_bytes / 1024**power:.{min(power, 1)}f} {('B', 'KiB', 'MiB', 'GiB', 'TiB')[power]}"
    )


def _wanted(
    topics: list[str] | None, regex: str | None, exclude: str | None
) -> Callable[[str], bool]:
    """Return whether a topic is meant: named, or found by a pattern; all that are not hidden without either."""
    from sfglab.bus.listing import is_hidden

    found, without = (
        _pattern(text, name) for text, name in ((regex, "--regex"), (exclude, "--exclude-regex"))
    )

    def wanted(topic: str) -> bool:
        if without and without.search(topic):
            return False
        named = bool(topics and topic in topics) or bool(found and found.search(topic))
        return named if topics or found else not is_hidden(topic)

    return wanted


def _pattern(text: str | None, option: str) -> re.Pattern[str] | None:
    try:
        return None if text is None else re.compile(text)
    except re.error as error:
        raise InvalidValueError(option, text, f"a regular expression ({error})") from error


@app.command()
def record(
    topics: Annotated[
        list[str] | None, Argument(help="Topics, e.g. /chatter; none with -a or -e.")
    ] = None,
    every: Annotated[bool, Option("--all", "-a", help="All topics that are not hidden.")] = False,
    regex: _Regex = None,
    exclude: _Exclude = None,
    output: Annotated[
        Path | None,
        Option("--output", "-o", metavar="FILE.mcap", help="New file. [default: by the time]"),
    ] = None,
    duration: Annotated[float | None, Option(min=0.1, help="Seconds; else until Ctrl-C.")] = None,
    domain: Domain = None,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Record topics, also those that appear later, into an MCAP file, until Ctrl-C.

    Examples:
      sfglab log record /chatter /tf /tf_static --domain 7
      sfglab log record -a -o session.mcap --duration 5
      sfglab log record -e '^/global/go2/' -x image_raw
    """
    from sfglab.bus.recording import Recorder
    from sfglab.record import LogWriter

    if not (topics or every or regex):
        raise InvalidValueError("log record", None, "topics, --all or --regex")
    wanted = _wanted(None if every else topics, None if every else regex, exclude)
    path = output or Path(f"rosbag2_{datetime.now(UTC).astimezone():%Y_%m_%d-%H_%M_%S}.mcap")
    _check_output(path)

    async def run(node: Node) -> None:
        recorder = Recorder(
            node,
            lambda: LogWriter(path),
            wanted=wanted,
            told=typer.echo,
        )
        try:
            async with asyncio.timeout(duration):
                await recorder.run()
        except TimeoutError:
            pass
        except OSError as error:
            held = f"a path that can be written ({error}); what was recorded until then is in it"
            raise InvalidValueError("--output", str(path), held) from error
        finally:
            if path.exists():
                typer.echo(f"{path}: {_counted(recorder.counts)}, {recorder.lost} lost")

    until_interrupted((domain, interface), run)


def _check_output(path: Path) -> None:
    if path.suffix != ".mcap":
        raise InvalidValueError("--output", str(path), "a name that ends in .mcap")
    if os.path.lexists(path):
        raise InvalidValueError("--output", str(path), "a path where nothing is yet")
    if not os.access(path.absolute().parent, os.W_OK):
        raise InvalidValueError("--output", str(path), "a path in a folder that can be written")


def record_for(path: Path, seconds: float, place: Place) -> None:
    """Record all that is not hidden nor every node's own for some seconds, once something is found."""
    from sfglab.bus.recording import Recorder
    from sfglab.record import LogWriter

    wanted = _wanted(None, None, r"^/(rosout|parameter_events)$")

    async def run(node: Node) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await Recorder(
                    node, lambda: LogWriter(path), wanted=wanted, told=lambda _: None
                ).run()

    on_node(place, run)


def _counted(counts: Mapping[str, int]) -> str:
    return f"{sum(counts.values())} messages of {len(counts)} topics"


@app.command()
def play(
    path: _Log_,
    rate: Annotated[
        float, Option("--rate", "-r", min=0.001, help="How much faster than recorded.")
    ] = 1.0,
    topics: _Topics = None,
    regex: _Regex = None,
    exclude: _Exclude = None,
    start: _Start = 0.0,
    duration: _Duration = None,
    domain: Domain = None,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Publish what a log holds as it was recorded, once the subscriptions that are there have been found.

    Examples:
      sfglab log play bag/ --domain 7
      sfglab log play run.mcap --rate 2 --topics /tf --topics /tf_static
      sfglab log play data/reference/mocap.mcap --topics /tf --duration 2 --domain 7
    """
    from sfglab.bus.recording import Player, Playing

    how = Playing(rate=rate, start_s=start, duration_s=duration)
    wanted = _wanted(topics, regex, exclude)

    async def run(node: Node) -> None:
        player = Player(
            node, path, how, wanted=wanted, told=lambda said: typer.echo(said, err=True)
        )
        try:
            await player.run()
        finally:
            typer.echo(f"played {_counted(player.counts)}")

    until_interrupted((domain, interface), run)
