"""The command that shows a fleet or a log in the Rerun viewer."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from sfglab.cli.buses import Place, domain_option, until_interrupted, unused
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.removed import refuse
from sfglab.domains import usual_domain_id
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.view.app import ViewOptions
    from sfglab.view.session import Session

_FOXGLOVE = "use ROS 2's foxglove_bridge; Foxglove opens logs of sfglab as they are"
_SERVED_PORT = 9876  #: Where `serve` waits when nothing else is said; the viewer's own default.


def view(
    log: Annotated[
        Path | None,
        Argument(help="An MCAP file or a rosbag2 folder; without it the bus is shown live."),
    ] = None,
    to: Annotated[
        list[str] | None,
        Option(
            help="FILE.rrd, viewer, serve[[:ADDRESS]:PORT] or rerun+http://HOST:PORT/proxy; may be repeated. "
            "[default: viewer, where there is a display]"
        ),
    ] = None,
    fleet: Annotated[
        Path | None,
        Option(help="A fleet file, for the layout, the expected agents and the border."),
    ] = None,
    frame: Annotated[
        str,
        Option(
            help="Frame in which space is drawn. "
            "[default: map with a fleet file, else the root of the log's largest TF tree]"
        ),
    ] = "",
    topic: Annotated[
        list[str] | None, Option(help="Only topics that begin so; may be repeated.")
    ] = None,
    memory: Annotated[
        str, Option(help="How much a viewer or server started here may keep: a share, or as 4GB.")
    ] = "25%",
    thin: Annotated[
        bool, Option("--thin", help="Thin a log out by the visualizers' rates, as live always is.")
    ] = False,
    domain: Annotated[int | None, domain_option("DDS domain to look at, live.")] = None,
    interface: Annotated[
        str | None, Option(help="Network interface, live; lo stays inside.")
    ] = None,
    _interfaces: Interfaces = None,
) -> None:
    """Show what is on the bus, or a log, in the Rerun viewer or a file (paper A, section 4.5).

    Everything is shown that an installed visualizer knows; Ctrl-C ends, and a file is then whole.

    Examples:
      sfglab view --domain 7
      sfglab view --fleet data/fleets/lab.yaml --interface wlan0 --topic /global/go2
      sfglab view data/reference/cooperation.mcap --to cooperation.rrd
      sfglab view bag/ --to serve:0.0.0.0:9876   # elsewhere: rerun rerun+http://HOST:9876/proxy
    """
    from sfglab.view.app import ViewOptions

    if any(place.partition(":")[0] == "foxglove" for place in to or ()):
        refuse("view --to foxglove", _FOXGLOVE)
    os.environ.setdefault("RUST_LOG", "off")  # Rerun's own lines; what fails is said once, by us
    options = ViewOptions(
        to=tuple(to or _default_place()),
        fleet=fleet,
        frame=frame,
        topics=tuple(topic or ()),
        memory=memory,
        thin=thin,
    )
    place = usual_domain_id() if domain is None else domain, interface
    if log is None:
        unused("without a log; what is shown live is always thinned out", "thin")
        _live(options, place)
        return
    unused("with a log, which is on no bus", "domain", "interface")
    _logged(log, options)


def _default_place() -> Sequence[str]:
    """Return the viewer, if it has a display to appear on.

    Raises:
        SfglabError: It has none.
    """
    if (
        sys.platform in ("darwin", "win32")
        or os.environ.get("DISPLAY")
        or os.environ.get("WAYLAND_DISPLAY")
    ):
        return ("viewer",)
    raise SfglabError(
        "there is no display for a viewer: give --to FILE.rrd, or --to serve:0.0.0.0:9876 and look at it from "
        "another host: rerun rerun+http://<this host>:9876/proxy"
    )


def _logged(log: Path, options: ViewOptions) -> None:
    from tqdm import tqdm

    from sfglab.record import LogReader
    from sfglab.view.app import view_log
    from sfglab.view.space import largest_tree_root

    with LogReader(log) as reader:
        types = sorted({info.type_name for info in reader.topics.values()})
        count = sum(info.count for info in reader.topics.values())
        cut = "; it was cut off, what is left of it is shown" if reader.truncated else ""
    space = ""
    if not options.frame and options.fleet is None:
        options = replace(options, frame=largest_tree_root(log))
        if options.frame:
            space = f"; space is drawn in {options.frame}, the root of the largest TF tree"
    place = f"go to {', '.join(options.to)}{cut}{space}"
    typer.echo(f"{log}: {count} messages of {len(reader.topics)} topics {place}")

    def stay(session: Session) -> None:
        """Tell what was shown, and keep a server up until Ctrl-C: it has the data."""
        _tell(session)
        if not session.displays:
            typer.echo(f"no visualizer shows what is in it: {', '.join(types) or 'nothing'}")
        if _announce(options):
            threading.Event().wait()

    try:
        bar = partial(
            tqdm, total=count, unit=" messages", leave=False, disable=None
        )  # only at a terminal
        view_log(log, options, progress=bar, on_shown=stay)
    except KeyboardInterrupt:
        typer.echo("ended")


def _live(options: ViewOptions, place: Place) -> None:
    from sfglab.view.app import view_live

    sessions: list[Session] = []

    def started(session: Session) -> None:
        sessions.append(session)
        typer.echo(f"domain {place[0]} goes to {', '.join(options.to)}; Ctrl-C ends")
        _announce(options)

    try:
        until_interrupted(
            place, lambda node: view_live(node, options, on_start=started), "view", err=False
        )
    finally:
        for session in sessions:
            _tell(session)


def _announce(options: ViewOptions) -> bool:
    """Say how to look at what is served; return whether anything is."""
    served = [place for place in options.to if place.partition(":")[0] == "serve"]
    for place in served:
        address, _, port = place.partition(":")[2].rpartition(":")
        host = "<this host>" if address == "0.0.0.0" else address or "127.0.0.1"  # noqa: S104 - asked for
        typer.echo(f"rerun rerun+http://{host}:{port or _SERVED_PORT}/proxy")
    return bool(served)


def _tell(session: Session) -> None:
    """Sum up, and say one line for each display of which not everything was shown."""
    from sfglab.view.app import report_of

    reports = report_of(session)
    typer.echo(f"{len(reports)} displays, {sum(report.shown for report in reports)} updates shown")
    for report in reports:
        if report.errors or report.dropped:
            failed = f", {report.errors} not shown: {report.last_error}" if report.errors else ""
            place = f"{report.display} ({', '.join(report.topics)})"
            typer.echo(f"{place}: {report.dropped} of {report.received} messages dropped{failed}")
