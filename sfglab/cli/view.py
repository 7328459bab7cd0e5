"""The command that shows a domain or a log in the Rerun viewer: ``sfglab view``."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from sfglab.cli.buses import Place, until_interrupted, unused
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.options import Domain, Fleet, Interface
from sfglab.cli.removed import refuse
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.view.app import ViewOptions
    from sfglab.view.session import Session

_ELSEWHERE = "write a file with --to FILE.rrd, and open it with rerun on the other host"
_REMOVED = {
    "foxglove": "use ROS 2's foxglove_bridge; Foxglove opens logs of sfglab as they are",
    "serve": _ELSEWHERE,
    "rerun+http": _ELSEWHERE,
}
"""Former outputs with what to use instead."""


def view(
    log: Annotated[
        Path | None,
        Argument(metavar="LOG", help="MCAP file or rosbag2 folder. [default: a domain, live]"),
    ] = None,
    to: Annotated[
        list[str] | None,
        Option(
            help="Output (repeatable): FILE.rrd or viewer. [default: viewer, if there is a display]"
        ),
    ] = None,
    fleet: Fleet = None,
    root_frame: Annotated[
        str,
        Option(
            help="Root frame of the 3D view. [default: map with --fleet, otherwise the root of "
            "the log's largest TF tree]"
        ),
    ] = "",
    topic: Annotated[
        list[str] | None,
        Option(help="Beginning of the topics to show (repeatable). [default: all topics]"),
    ] = None,
    domain: Domain = 0,
    interface: Interface = None,
    _interfaces: Interfaces = None,
) -> None:
    """Show a domain or a log in the Rerun viewer, or write it into a file (paper A, section 4.5).

    All topics are shown whose types an installed visualizer supports. Ctrl-C ends, and a file is complete then.

    Examples:
      sfglab view --domain 7
      sfglab view --fleet data/fleets/lab.yaml --interface wlan0 --topic /global/go2
      sfglab view data/reference/cooperation.mcap --to cooperation.rrd
    """
    from sfglab.view.app import ViewOptions

    for output in to or ():
        kind = output.partition(":")[0]
        if kind in _REMOVED:
            refuse(f"view --to {kind}", _REMOVED[kind])
    os.environ.setdefault("RUST_LOG", "off")  # Errors are reported once, by sfglab.
    options = ViewOptions(
        to=tuple(to or _default_output()),
        fleet=fleet,
        frame=root_frame,
        topics=tuple(topic or ()),
    )
    if log is not None:
        unused("with a log, because only a domain is observed", "domain", "interface")
        _show_log(log, options)
        return
    _show_domain((domain, interface), options)


def _default_output() -> tuple[str]:
    """Return the viewer if it has a display."""
    if any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
        return ("viewer",)
    raise SfglabError(
        "there is no display for a viewer; give --to FILE.rrd, and open the file with rerun on "
        "another host"
    )


def _show_log(log: Path, options: ViewOptions) -> None:
    from tqdm import tqdm

    from sfglab.record import LogReader
    from sfglab.view.app import view_log

    with LogReader(log) as reader:
        topics = list(reader.topics.values())
        truncated = reader.truncated
    counts = [info.count for info in topics]
    count = sum(counts)
    line = f"{log}: {count} messages of {len(topics)} topics go to {', '.join(options.to)}"
    if truncated:
        line += "; the log was cut off, and its rest is shown"
    typer.echo(line)
    bar = partial(tqdm, total=count, unit=" messages", leave=False, disable=None)
    session = view_log(log, options, progress=bar)
    _report(session)
    if not session.displays:
        types = {info.type_name for info in topics}
        typer.echo(f"no visualizer shows its types: {', '.join(sorted(types)) or 'none'}")


def _show_domain(place: Place, options: ViewOptions) -> None:
    from sfglab.view.app import view_live

    sessions: list[Session] = []

    def started(session: Session) -> None:
        sessions.append(session)
        typer.echo(f"domain {place[0]} goes to {', '.join(options.to)}; Ctrl-C ends")

    async def show(node: Node) -> None:
        await view_live(node, options, on_start=started)

    try:
        until_interrupted(place, show, "view")
    finally:
        for session in sessions:
            _report(session)


def _report(session: Session) -> None:
    """Print the number of updates, and what cannot be used or shown, or was dropped."""
    updates = [display.slot.shown for display in session.displays]
    typer.echo(f"{len(updates)} displays, {sum(updates)} updates shown")
    for problem in session.problems:
        typer.echo(problem)
    for display in session.displays:
        slot = display.slot
        if display.errors or slot.dropped:
            topics = ", ".join(display.topics.values())
            line = f"{display.id} ({topics}): {slot.dropped} of {slot.received} messages dropped"
            if display.errors:
                line += f", {display.errors} not shown: {display.last_error}"
            typer.echo(line)
