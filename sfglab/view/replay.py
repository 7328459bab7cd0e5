"""A log, drawn as it was received: without gaps, as fast as the sinks take it.

The same displays as live; only the clock is the log's, and nothing is pushed out of a queue.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.view.stage import Stage, Surface

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from sfglab.view.arrivals import Arrival
    from sfglab.view.session import Session


_STEP_NS = 100_000_000
_MOST_STEPS = 3000
"""Of a silence that is longer than five minutes the rest is passed over."""


def wanted_topics(session: Session) -> frozenset[str]:
    """Return the topics of all displays."""
    return frozenset(t for display in session.displays for t in display.visualizer.topics.values())


def replay(arrivals: Iterable[Arrival], session: Session, surface: Surface) -> int:
    """Draw messages, and what changes with time between them.

    Args:
        arrivals: In the order in which they were received.
        session: What is shown.
        surface: What is drawn on; it stays open.

    Returns:
        How many messages were read.

    Raises:
        SinkError: The surface does not take any more.
    """
    stage, count, last_ns = Stage(session), 0, None
    try:
        for count, arrival in enumerate(arrivals, start=1):  # noqa: B007 - counts what was read
            for now_ns in _moments(last_ns, arrival.received_ns):
                if (due := stage.tick(now_ns)) is not None:
                    due.draw(surface)
            last_ns = arrival.received_ns
            stage.deliver(arrival)
            while (job := stage.ready()) is not None:
                job.draw(surface)
    finally:
        stage.close()
    return count


def _moments(last_ns: int | None, now_ns: int) -> Iterator[int]:
    """Yield when ticks may be due between two messages, so that silence is seen when it began; and `now_ns`."""
    if last_ns is not None:
        quiet_ns = range(last_ns + _STEP_NS, now_ns, _STEP_NS)
        yield from quiet_ns[:_MOST_STEPS]
    yield now_ns
