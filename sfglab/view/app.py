"""Entry points of ``sfglab view`` and of notebooks: from a log or a domain to a viewer, a file or a cell.

An interruption ends a view cleanly: everything drawn until then is sent, and a file is complete.
"""

from __future__ import annotations

import asyncio
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.record import LogReader
from sfglab.validation import suggestion
from sfglab.view import rerunning
from sfglab.view.arrivals import Arrival, arrivals_of
from sfglab.view.bridge import Bridge
from sfglab.view.session import Session
from sfglab.view.space import largest_tree
from sfglab.view.stage import replay, wanted_topics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from sfglab.bus import Node


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptions:
    """Outputs and contents of a view."""

    to: tuple[str, ...] = ("viewer",)  #: Outputs; see `open_canvas`.
    fleet: Path | None = None  #: Fleet file whose cameras are laid out.
    #: Frame in which space is drawn; empty: ``map`` with a fleet file, else the root of a log's
    #: largest TF tree, else the viewer's choice.
    frame: str = ""
    topics: tuple[str, ...] = ()  #: Only topics with one of these beginnings; empty for all.


def session_for(topics: Mapping[str, str], options: ViewOptions) -> Session:
    """Return a session with every display that installed visualizers offer for some topics.

    Args:
        topics: ROS type of each topic, by the topic's name.
        options: Contents of the view.

    Raises:
        InvalidValueError: There are topics, and none begins with one of `ViewOptions.topics`.
    """
    session = Session()
    chosen = {
        t: kind for t, kind in topics.items() if not options.topics or t.startswith(options.topics)
    }
    if topics and not chosen:
        there = ", ".join(topics) + suggestion(options.topics[0], topics)
        raise InvalidValueError(
            "--topic", " ".join(options.topics), f"the beginning of one of {there}"
        )
    for offer in session.offers(chosen):
        session.add_offer(offer)
    return session


def types_of(log: LogReader) -> dict[str, str]:
    """Return the type of each topic of a log."""
    return {topic: info.type_name for topic, info in log.topics.items()}


def view_log(
    path: str | Path,
    options: ViewOptions,
    *,
    progress: Callable[[Iterator[Arrival]], Iterable[Arrival]] = iter,
) -> Session:
    """Show a log with all visualizers that suit its topics, and return the session.

    The displays of the session have the numbers of shown and dropped messages.

    Args:
        path: MCAP file or rosbag2 folder.
        options: Outputs and contents of the view.
        progress: Function that passes the messages on, and may count them.

    Raises:
        SfglabError: The log cannot be read (LogError).
        SinkError: An output no longer accepts data.
        MissingExtraError: Rerun is not installed.
    """
    with LogReader(path) as log:
        topics = types_of(log)
        session = session_for(topics, options)
        for display in session.displays:
            session.limit(display.id, None)
        if not options.frame and options.fleet is None:
            options = replace(options, frame=largest_tree(log).root)
        with closing(_canvas(options, topics, Path(path).stem)) as canvas:
            replay(progress(arrivals_of(log, wanted_topics(session))), session, canvas)
    return session


async def view_live(
    node: Node, options: ViewOptions, *, on_start: Callable[[Session], None] = lambda _: None
) -> None:
    """Show every topic of a domain that visualizers can show, until cancelled.

    Args:
        node: Node on the domain.
        options: Outputs and contents of the view.
        on_start: Called with the session, which may be changed, when the bridge runs.

    Raises:
        SinkError: An output no longer accepts data.
        MissingExtraError: Rerun is not installed.
    """
    session = Session()
    canvas = await asyncio.to_thread(_canvas, options, {}, node.name)
    async with Bridge(node, session, canvas, follow=options.topics or ("/",)) as bridge:
        on_start(session)
        await bridge.failed()


def _canvas(options: ViewOptions, topics: Mapping[str, str], title: str) -> rerunning.RerunCanvas:
    if options.fleet is None:
        layout = rerunning.layout_of_topics(topics, frame=options.frame)
    else:
        from sfglab.fleet.fleet_file import load_fleet

        layout = rerunning.layout_of_fleet(load_fleet(options.fleet), frame=options.frame or "map")
    canvas = rerunning.open_canvas(options.to, title=title)
    canvas.recording.send_blueprint(rerunning.blueprint(layout))
    return canvas
