"""Entry points of ``sfglab view`` and of notebooks: from a log or a domain to a viewer, a file or a cell.

An interruption ends a view cleanly: what was drawn up to then is sent, and a file is complete.
"""

from __future__ import annotations

import asyncio
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.validation import suggestion
from sfglab.view import rerunning
from sfglab.view.arrivals import Arrival, open_log
from sfglab.view.bridge import Bridge
from sfglab.view.session import Display, Session
from sfglab.view.space import largest_tree_root
from sfglab.view.stage import replay, wanted_topics

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from sfglab.bus import Node


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptions:
    """Outputs of a view, and what it shows."""

    to: tuple[str, ...] = ("viewer",)  #: Outputs; see `open_canvas`.
    fleet: Path | None = None  #: Fleet file whose cameras are laid out.
    #: Frame in which space is drawn; empty: ``map`` with a fleet file, else the root of a log's
    #: largest TF tree, else the viewer's choice.
    frame: str = ""
    topics: tuple[str, ...] = ()  #: Only topics with one of these beginnings; empty for all.
    memory: str = "25%"  #: Memory limit of a viewer that is started here.
    #: Whether a log is thinned out by the visualizers' rate budgets, as the bus always is.
    thin: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Counts of one display."""

    display: str  #: Its id.
    topics: tuple[str, ...]  #: Its topics.
    received: int  #: Messages that reached it.
    shown: int  #: Updates drawn.
    dropped: int  #: Messages and sets passed over.
    errors: int  #: Updates that could not be drawn.
    last_error: str  #: Why the latest could not.


def session_for(topics: Mapping[str, str], options: ViewOptions) -> Session:
    """Return a session with every display that installed visualizers offer for topics, given type by topic."""
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
        session.add(offer.kind, offer.topics)
    return session


def view_log(
    path: str | Path,
    options: ViewOptions,
    *,
    session: Session | None = None,
    progress: Callable[[Iterator[Arrival]], Iterable[Arrival]] = iter,
) -> tuple[Report, ...]:
    """Show a log, and return what became of the messages, one report per display.

    Args:
        path: MCAP file or rosbag2 folder.
        options: Where and how to show it.
        session: Displays; by default all that can show a topic of the log.
        progress: Passes the messages on, and may count them.

    Raises:
        SfglabError: The log cannot be read (LogError).
        SinkError: An output does not take what is shown.
        MissingExtraError: Rerun is not installed.
    """
    with open_log(path) as log:
        topics = log.topics
        if session is None:
            session = session_for(topics, options)
            for display in session.displays if not options.thin else ():
                session.limit(display.id, None)
        if not options.frame and options.fleet is None:
            options = replace(options, frame=largest_tree_root(path))
        with closing(_canvas(options, topics, Path(path).stem)) as canvas:
            replay(progress(log.arrivals(wanted_topics(session))), session, canvas)
            canvas.flush()
    return report_of(session)


async def view_live(
    node: Node,
    options: ViewOptions,
    *,
    session: Session | None = None,
    on_start: Callable[[Session], None] = lambda _: None,
) -> None:
    """Show a domain until cancelled.

    Args:
        node: Node on the domain.
        options: Where and how to show it.
        session: Displays, which may change meanwhile; by default every topic is followed that can be shown.
        on_start: Called with the session when the bridge runs.

    Raises:
        SinkError: An output does not take what is shown.
        MissingExtraError: Rerun is not installed.
    """
    follow = session is None
    session = session or session_for({}, options)
    canvas = await asyncio.to_thread(_canvas, options, {}, node.name)
    follows = (options.topics or ("/",)) if follow else ()
    with closing(canvas):
        async with Bridge(node, session, canvas, follow=follows) as bridge:
            on_start(session)
            await bridge.failed()


def report_of(session: Session) -> tuple[Report, ...]:
    """Return the counts of a session, one report per display."""
    return tuple(_report(display) for display in session.displays)


def _report(display: Display) -> Report:
    counts = display.slot.counts
    return Report(
        display=display.id,
        topics=tuple(display.visualizer.topics.values()),
        received=counts.received,
        shown=counts.shown,
        dropped=counts.dropped,
        errors=display.errors,
        last_error=display.last_error,
    )


def _canvas(options: ViewOptions, topics: Mapping[str, str], title: str) -> rerunning.RerunCanvas:
    layout: Any = rerunning.layout_of_topics(topics, frame=options.frame)
    if options.fleet is not None:
        from sfglab.fleet.fleet_file import load_fleet

        layout = rerunning.layout_of_fleet(load_fleet(options.fleet), frame=options.frame or "map")
    canvas = rerunning.open_canvas(options.to, title=title, memory=options.memory)
    canvas.show_blueprint(rerunning.blueprint(layout))
    if rerunning.NOTEBOOK in options.to:
        canvas.show_in_notebook()
    return canvas
