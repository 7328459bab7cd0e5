"""Delivery of messages to the displays of a session, jobs that draw them, and replay of a log.

The caller passes the time. A log is replayed with its own clock, as fast as the outputs accept it, and no queue drops
anything. One thread calls `deliver` and `jobs`. Another thread, always the same one, may run the jobs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING, Protocol

from sfglab.errors import SfglabError
from sfglab.units import NS_PER_S
from sfglab.view.arrivals import Arrival, capture_ns, decoded
from sfglab.view.visualizer import Canvas, NotShownError, SinkError, Update

if TYPE_CHECKING:
    from sfglab.view.session import Display, Session
    from sfglab.view.slot import Taken

_STEP_NS = 100_000_000
_MOST_STEPS = 3000  #: Largest number of steps in a gap between messages: five minutes.


class Surface(Canvas, Protocol):
    """A canvas that limits the data in flight and can be closed."""

    def settle(self, size_bytes: int) -> None:
        """Count an update of `size_bytes` bytes, and wait while too many bytes are in flight.

        Raises:
            SinkError: An output no longer accepts data.
        """

    def close(self) -> None:
        """Send the remaining data and close the outputs; further calls have no effect."""


Job = Callable[[Surface], None]
"""Function that draws an update or ticks; errors are recorded at the display, except a SinkError, which is raised."""


def _show(display: Display, taken: Taken[Arrival], surface: Surface) -> None:
    """Draw one update of a display; it counts as shown when the surface has accepted it."""
    arrivals = taken.items.values()
    received_ns = max(arrival.received_ns for arrival in arrivals)

    def draw() -> None:
        messages = {role: decoded(arrival) for role, arrival in taken.items.items()}
        update = Update(
            messages=messages, stamp_ns=taken.stamp_ns, received_ns=received_ns, lost=taken.lost
        )
        display.visualizer.show(update, surface)

    surface.at(stamp_ns=taken.stamp_ns, received_ns=received_ns)
    is_drawn = _succeeds(display, draw)
    surface.settle(sum(len(arrival.cdr) for arrival in arrivals))
    display.slot.shown += is_drawn


def _tick(due: tuple[Display, ...], now_ns: int, surface: Surface) -> None:
    """Draw the displays whose tick is due."""
    surface.at(stamp_ns=now_ns, received_ns=now_ns)
    for display in due:
        _succeeds(display, partial(display.visualizer.tick, now_ns, surface))
    surface.settle(0)


def _succeeds(display: Display, draw: Callable[[], None]) -> bool:
    """Draw, and return whether that succeeded; an error is recorded at the display and does not affect others."""
    try:
        draw()
    except SinkError:
        raise
    except NotShownError:
        return False
    except SfglabError as error:
        display.fail(str(error))
        return False
    except Exception as error:  # noqa: BLE001 - a plug-in may raise any error
        display.fail(f"{type(error).__name__}: {error}")
        return False
    return True


class Stage:
    """The displays of a session, which may change at any time."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._wanted: dict[str, list[tuple[Display, str]]] = {}
        self._ticked_ns: dict[str, int] = {}
        self._turn = 0
        #: Ends the notifications by the session; further calls have no effect.
        self.close = session.listen(self._index)

    def deliver(self, arrival: Arrival) -> None:
        """Put a message into the queues of all displays of its topic."""
        wanted = self._wanted.get(arrival.topic)
        if not wanted:
            return
        stamp_ns = capture_ns(arrival)
        for display, role in wanted:
            if display.enabled:
                display.slot.offer(role, stamp_ns, arrival, now_ns=arrival.received_ns)

    def jobs(self, now_ns: int) -> Iterator[Job]:
        """Yield the jobs at a reception time, ns: first due ticks, then one waiting set of each display in turn."""
        due = tuple(d for d in self._session.displays if d.enabled and self._is_due(d, now_ns))
        if due:
            yield partial(_tick, due, now_ns)
        while (job := self._next()) is not None:
            yield job

    def _next(self) -> Job | None:
        displays = self._session.displays
        for offset in range(len(displays)):
            index = (self._turn + offset) % len(displays)
            taken = displays[index].slot.take()
            if taken is not None:
                self._turn = index + 1
                return partial(_show, displays[index], taken)
        return None

    def _is_due(self, display: Display, now_ns: int) -> bool:
        """Return whether a display's tick is due now, and remember it; a clock may jump back."""
        tick_hz = display.visualizer.tick_hz
        last_ns = self._ticked_ns.get(display.id)
        if not tick_hz or (last_ns is not None and 0 <= now_ns - last_ns < NS_PER_S / tick_hz):
            return False
        self._ticked_ns[display.id] = now_ns
        return True

    def _index(self) -> None:
        """Update the table of displays by topic."""
        self._wanted = {}
        for display in self._session.displays:
            for role, topic in display.topics.items():
                self._wanted.setdefault(topic, []).append((display, role))


def wanted_topics(session: Session) -> frozenset[str]:
    """Return the topics to which the displays of a session are bound."""
    return frozenset(topic for display in session.displays for topic in display.topics.values())


def replay(arrivals: Iterable[Arrival], session: Session, surface: Surface) -> None:
    """Draw messages, and between them the ticks of the displays.

    Raises:
        SinkError: The surface no longer accepts data.
    """
    last_ns: int | None = None
    with closing(Stage(session)) as stage:
        for arrival in arrivals:
            now_ns = arrival.received_ns
            if last_ns is not None:  # so that the beginning of a gap is drawn at its time
                for moment_ns in range(last_ns + _STEP_NS, now_ns, _STEP_NS)[:_MOST_STEPS]:
                    _do(stage, moment_ns, surface)
            last_ns = now_ns
            _do(stage, now_ns, surface)
            stage.deliver(arrival)
            _do(stage, now_ns, surface)


def _do(stage: Stage, now_ns: int, surface: Surface) -> None:
    for job in stage.jobs(now_ns):
        job(surface)
