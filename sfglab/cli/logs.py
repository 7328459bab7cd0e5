"""Commands for logs and bags: ``sfglab log``, in the words of ``ros2 bag``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from sfglab.cli.buses import print_json, until_interrupted, unused
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.options import Domain, Duration, Interface, Json
from sfglab.errors import InvalidValueError
from sfglab.tables import text_table
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.record import LogReader


app = typer.Typer(
    help="""Record and play topics, and print what a log or bag contains, like ros2 bag.

Without a command: list the logs of experiments, and whether each counts for the claims.

Examples:
  sfglab log
  sfglab log info data/reference/mocap.mcap""",
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


@app.callback(invoke_without_command=True)
def log(context: typer.Context) -> None:
    """List the logs of experiments, unless a command follows."""
    from sfglab.lab.experiments import EXPERIMENTS
    from sfglab.lab.ledger import find_log, logs_of
    from sfglab.lab.paths import find_project
    from sfglab.lab.runs import standing

    if context.invoked_subcommand is not None:
        return
    project = find_project()
    rows = [("log", "profile", "counts for the claims")]
    for name in EXPERIMENTS:
        chosen = find_log(project, name)
        for path in logs_of(project, name):
            found = standing(path)
            counts = "yes"
            if found.why_not:
                counts = f"no: {found.why_not}"
            elif path != chosen:
                counts = "no: a newer one does"
            rows.append((project.relative(path), found.profile, counts))
    typer.echo(text_table(rows))


@app.command()
def info(path: _Path, as_json: Json = False) -> None:
    """Print the files, times, topics and metadata of a log or bag.

    Example:
      sfglab log info data/reference/mocap.mcap
    """
    from sfglab.record import LogReader

    with LogReader(path) as reader:
        values = _content(reader)
        if as_json:
            print_json(values)
            return
    start_ns, end_ns = values["start_ns"], values["end_ns"]
    start = datetime.fromtimestamp(start_ns // NS_PER_S, UTC).astimezone()
    rows = [[_cell(value) for value in topic.values()] for topic in values["topics"]]
    lines = [
        f"files     {', '.join(values['files'])}",
        f"size      {values['size_bytes'] / 2**20:.3f} MiB",
        f"start     {start:%Y-%m-%d %H:%M:%S %z}",
        f"duration  {(end_ns - start_ns) / NS_PER_S:.3f} s",
        f"messages  {values['messages']}",
        text_table([_COLUMNS, *rows]),
    ]
    for name, value in values["metadata"].items():
        lines.append(f"metadata  {name}: {json.dumps(value)}")
    if values["truncated"]:
        lines.append("the log was cut off; this is all that it contains")
    typer.echo("\n".join(lines))


_COLUMNS = ("topic", "type", "messages", "Hz", "bytes", "encoding")


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _content(reader: LogReader) -> dict[str, Any]:
    """Return the content of a log; rates [Hz] and mean sizes of topics are of their first messages."""
    from sfglab.record.reader import rate_and_size

    topics = []
    for name, topic in reader.topics.items():
        rate_hz, size_bytes = rate_and_size(reader.first(name))
        described = {
            "name": name,
            "type": topic.type_name,
            "count": topic.count,
            "rate_hz": rate_hz or None,
            "size_bytes": round(size_bytes) or None,
            "encoding": topic.encoding,
        }
        topics.append(described)
    counts = [topic.count for topic in reader.topics.values()]
    sizes = [file.stat().st_size for file in reader.files]
    start_ns, end_ns = reader.span_ns
    return {
        "files": [file.name for file in reader.files],
        "size_bytes": sum(sizes),
        "start_ns": start_ns,
        "end_ns": end_ns,
        "messages": sum(counts),
        "topics": topics,
        "metadata": {name: reader.metadata(name) for name in reader.metadata_names},
        "truncated": reader.truncated,
    }


def _wanted(
    topics: list[str] | None, regex: str | None, exclude: str | None
) -> Callable[[str], bool]:
    """Return a function that tells whether a topic is selected by names or a pattern.

    Without names and pattern it selects the topics that are not hidden.
    """
    from sfglab.bus.listing import is_hidden

    try:
        pattern = re.compile(regex) if regex else None
        excluded = re.compile(exclude) if exclude else None
    except re.error as error:
        allowed = f"a regular expression ({error})"
        raise InvalidValueError("--regex or --exclude-regex", error.pattern, allowed) from error

    def is_wanted(topic: str) -> bool:
        if excluded and excluded.search(topic):
            return False
        if pattern and pattern.search(topic):
            return True
        if topics or pattern:
            return topic in (topics or ())
        return not is_hidden(topic)

    return is_wanted


@app.command()
def record(
    topics: Annotated[
        list[str] | None,
        Argument(metavar="TOPIC", help="Topic, e.g. /chatter, unless -a or -e is given."),
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
    domain: Domain = 0,
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
    if every:
        unused("with --all, which records all topics", "topics", "regex")
    wanted = _wanted(topics, regex, exclude)
    now = datetime.now(UTC).astimezone()
    path = output or Path(f"rosbag2_{now:%Y_%m_%d-%H_%M_%S}.mcap")
    if path.suffix != ".mcap" or path.exists():
        raise InvalidValueError("--output", str(path), "a new file whose name ends in .mcap")

    async def run(node: Node) -> None:
        recorder = Recorder(node, lambda: LogWriter(path), wanted=wanted, on_log=typer.echo)
        try:
            await recorder.run()
        except OSError as error:
            raise InvalidValueError(f"--output {path}", error, "a writable file") from error
        finally:
            if path.exists():
                typer.echo(f"{path}: {_counted(recorder.counts)}, {recorder.lost} lost")

    until_interrupted((domain, interface), run, duration_s=duration)


def _counted(counts: Mapping[str, int]) -> str:
    return f"{sum(counts.values())} messages of {len(counts)} topics"


@app.command()
def play(
    path: _Path,
    rate: Annotated[
        float, Option("--rate", "-r", min=0.001, help="Speed relative to the recording.")
    ] = 1.0,
    topics: Annotated[
        list[str] | None,
        Option(
            "--topics", help="Topic to play (repeatable). [default: all topics but hidden ones]"
        ),
    ] = None,
    regex: _Regex = None,
    exclude: _Exclude = None,
    start: Annotated[
        float, Option("--start-offset", min=0.0, help="Time at the start of the log to skip, s.")
    ] = 0.0,
    duration: Annotated[
        float | None,
        Option(min=0.0, help="Time of the log to play, s. [default: to the end of the log]"),
    ] = None,
    domain: Domain = 0,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Publish the messages of a log or bag with their recorded timing.

    Playing begins when all existing subscriptions match. It waits for slow reliable subscriptions, but for a
    stalled one at most 15 s.

    Examples:
      sfglab log play bag/ --domain 7
      sfglab log play run.mcap --rate 2 --topics /tf --topics /tf_static
      sfglab log play data/reference/cooperation.mcap --topics /tf --duration 2 --domain 7
    """
    from sfglab.bus.recording import Player, Playing

    how = Playing(rate=rate, start_s=start, duration_s=duration)
    wanted = _wanted(topics, regex, exclude)

    async def run(node: Node) -> None:
        player = Player(node, path, how, wanted=wanted, on_log=partial(typer.echo, err=True))
        try:
            await player.run()
        finally:
            typer.echo(f"played {_counted(player.counts)}")

    until_interrupted((domain, interface), run)
