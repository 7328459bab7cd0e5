"""Commands for logs and bags: ``sfglab log``, in the words of ``ros2 bag``."""

from __future__ import annotations

import asyncio
import json
import os
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

from sfglab.cli.buses import print_json, until_interrupted
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.options import Domain, Duration, Interface, Json
from sfglab.errors import InvalidValueError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.record import LogReader


class _Log(TyperGroup):
    """A group that runs `show` if the first word is none of its commands."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, the command and its arguments."""
        words = args if args[0] in self.commands else ["show", *args]
        return super().resolve_command(ctx, words)


app = typer.Typer(
    cls=_Log,
    help="""Record, play and list logs and bags, like ros2 bag; without a command, list runs.

Examples:

  sfglab log

  sfglab log data/reference/cooperation.mcap""",
)
_Path = Annotated[
    Path, Argument(metavar="LOG", help="MCAP file, rosbag2 folder or the folder's .db3 file.")
]
_Regex = Annotated[
    str | None, Option("--regex", "-e", help="Only topics that match this regular expression.")
]
_Exclude = Annotated[
    str | None,
    Option("--exclude-regex", "-x", help="No topics that match this regular expression."),
]


_CUT_OFF = "the log was cut off; this is all that it contains"


@app.callback(invoke_without_command=True)
def log(context: typer.Context) -> None:
    """List runs and whether each counts as evidence for claims, unless a command follows."""
    from sfglab.cli.experiments import list_runs

    if context.invoked_subcommand is None:
        list_runs()


@app.command(hidden=True)
def show(path: _Path, as_json: Json = False) -> None:
    """List the content of a log: topics, rates, sizes and metadata.

    Example:
      sfglab log data/reference/cooperation.mcap
    """
    from sfglab.record import LogReader
    from sfglab.tables import text_table

    with LogReader(path) as reader:
        metadata = {name: reader.metadata(name) for name in reader.metadata_names}
        head, *rows = reader.overview()
        if as_json:
            topics = [dict(zip(head, row, strict=True)) for row in rows]
            print_json({"topics": topics, "metadata": metadata})
            return
        typer.echo(text_table([head, *rows]))
        for name, values in metadata.items():
            typer.echo(f"metadata  {name}: {json.dumps(values)}")
        if reader.truncated:
            typer.echo(_CUT_OFF)


@app.command()
def info(path: _Path, as_json: Json = False) -> None:
    """Print a summary of a log, like ros2 bag info.

    Example:
      sfglab log info data/reference/mocap.mcap
    """
    from sfglab.record import LogReader

    with LogReader(path) as reader:
        values = _info(reader)
        is_cut_off = reader.truncated
    if as_json:
        print_json(values)
        return
    start_ns, end_ns = values["start_ns"], values["end_ns"]
    line = "Topic: {name} | Type: {type} | Count: {count} | Serialization Format: {encoding}"
    topics = map(line.format_map, values["topics"])
    indent = "\n" + " " * 19
    typer.echo(
        f"\nFiles:             {indent.join(values['files'])}\n"
        f"Bag size:          {_size(values['size_bytes'])}\n"
        f"Storage id:        {values['storage']}\n"
        f"Duration:          {_seconds(end_ns - start_ns)}s\n"
        f"Start:             {_date(start_ns)}\n"
        f"End:               {_date(end_ns)}\n"
        f"Messages:          {values['messages']}\n"
        f"Topic information: {indent.join(topics)}\n"
    )
    if is_cut_off:
        typer.echo(_CUT_OFF)


def _info(reader: LogReader) -> dict[str, Any]:
    topics = [
        {"name": name, "type": topic.type_name, "count": topic.count, "encoding": topic.encoding}
        for name, topic in reader.topics.items()
    ]
    start_ns, end_ns = reader.span_ns
    suffixes = {suffix for file in reader.files for suffix in file.suffixes}
    storages = {".db3": "sqlite3", ".mcap": "mcap"}
    found = [name for suffix, name in storages.items() if suffix in suffixes]
    sizes = [file.stat().st_size for file in reader.files]
    counts = [topic.count for topic in reader.topics.values()]
    return {
        "files": [file.name for file in reader.files],
        "size_bytes": sum(sizes),
        "storage": ", ".join(found),
        "start_ns": start_ns,
        "end_ns": end_ns,
        "messages": sum(counts),
        "topics": topics,
    }


def _seconds(time_ns: int) -> str:
    return f"{time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}"


def _date(time_ns: int) -> str:
    when = datetime.fromtimestamp(time_ns // NS_PER_S, UTC).astimezone()
    seconds = _seconds(time_ns)
    fraction = seconds.partition(".")[2]
    return f"{when:%b} {when.day:2d} {when:%Y %H:%M:%S}.{fraction} ({seconds})"


def _size(size_bytes: float) -> str:
    if size_bytes < 1024:
        return f"{size_bytes} B"
    for unit in ("KiB", "MiB", "GiB"):
        size_bytes /= 1024
        if size_bytes < 1024:
            return f"{size_bytes:.1f} {unit}"
    return f"{size_bytes / 1024:.1f} TiB"


def _wanted(
    topics: list[str] | None, regex: str | None, exclude: str | None
) -> Callable[[str], bool]:
    """Return whether a topic is named or matches; without names and pattern, whether it is not hidden."""
    from sfglab.bus.listing import is_hidden

    pattern = _pattern(regex, "--regex")
    excluded = _pattern(exclude, "--exclude-regex")

    def is_wanted(topic: str) -> bool:
        if excluded and excluded.search(topic):
            return False
        if pattern and pattern.search(topic):
            return True
        if topics or pattern:
            return topic in (topics or ())
        return not is_hidden(topic)

    return is_wanted


def _pattern(text: str | None, option: str) -> re.Pattern[str] | None:
    try:
        return None if text is None else re.compile(text)
    except re.error as error:
        raise InvalidValueError(option, text, f"a regular expression ({error})") from error


@app.command()
def record(
    topics: Annotated[
        list[str] | None, Argument(help="Topics, e.g. /chatter, unless -a or -e is given.")
    ] = None,
    every: Annotated[
        bool, Option("--all", "-a", help="Record all topics but hidden ones.")
    ] = False,
    regex: _Regex = None,
    exclude: _Exclude = None,
    output: Annotated[
        Path | None,
        Option(
            "--output",
            "-o",
            metavar="FILE.mcap",
            help="New file. [default: named after the date and time]",
        ),
    ] = None,
    duration: Duration = None,
    domain: Domain = None,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Record topics into an MCAP file until Ctrl-C, including topics that appear later.

    Examples:
      sfglab log record /chatter /tf /tf_static --domain 7
      sfglab log record -a -o session.mcap --duration 5
      sfglab log record -e '^/global/go2/' -x image_raw
    """
    from sfglab.bus.recording import Recorder
    from sfglab.record import LogWriter

    if not (topics or every or regex):
        raise InvalidValueError("log record", None, "topics, --all or --regex")
    wanted = _wanted(None, None, exclude) if every else _wanted(topics, regex, exclude)
    now = datetime.now(UTC).astimezone()
    path = output or Path(f"rosbag2_{now:%Y_%m_%d-%H_%M_%S}.mcap")
    _check_output(path)

    async def run(node: Node) -> None:
        recorder = Recorder(node, lambda: LogWriter(path), wanted=wanted, told=typer.echo)
        try:
            async with asyncio.timeout(duration):
                await recorder.run()
        except TimeoutError:
            pass
        except OSError as error:
            raise InvalidValueError(f"--output {path}", error, "a writable file") from error
        finally:
            if path.exists():
                typer.echo(f"{path}: {_counted(recorder.counts)}, {recorder.lost} lost")

    until_interrupted((domain, interface), run)


def _check_output(path: Path) -> None:
    """Refuse a path where no new log can be written."""
    allowed = ""
    if path.suffix != ".mcap":
        allowed = "a name that ends in .mcap"
    elif os.path.lexists(path):
        allowed = "a path that does not exist yet"
    elif not os.access(path.absolute().parent, os.W_OK):
        allowed = "a path in a writable folder"
    if allowed:
        raise InvalidValueError("--output", str(path), allowed)


def _counted(counts: Mapping[str, int]) -> str:
    return f"{sum(counts.values())} messages of {len(counts)} topics"


@app.command()
def play(
    path: _Path,
    rate: Annotated[
        float, Option("--rate", "-r", min=0.001, help="Speed relative to the recording.")
    ] = 1.0,
    topics: Annotated[
        list[str] | None, Option("--topics", help="Only this topic (repeatable).")
    ] = None,
    regex: _Regex = None,
    exclude: _Exclude = None,
    start: Annotated[
        float, Option("--start-offset", min=0.0, help="Time of the log to skip, s.")
    ] = 0.0,
    duration: Annotated[
        float | None,
        Option(min=0.0, help="Time of the log to play, s. [default: to its end]"),
    ] = None,
    domain: Domain = None,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Publish the messages of a log with their recorded timing, once existing subscriptions match.

    Examples:
      sfglab log play bag/ --domain 7
      sfglab log play run.mcap --rate 2 --topics /tf --topics /tf_static
      sfglab log play data/reference/mocap.mcap --topics /tf --duration 2 --domain 7
    """
    from sfglab.bus.recording import Player, Playing

    how = Playing(rate=rate, start_s=start, duration_s=duration)
    wanted = _wanted(topics, regex, exclude)

    async def run(node: Node) -> None:
        player = Player(node, path, how, wanted=wanted, told=partial(typer.echo, err=True))
        try:
            await player.run()
        finally:
            typer.echo(f"played {_counted(player.counts)}")

    until_interrupted((domain, interface), run)
