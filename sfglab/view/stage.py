"""Delivery of messages to the displays of a session, jobs that draw them, and replay of a log.

The clock is the caller's: a log is replayed by its own clock, as fast as the outputs take it, and nothing is
dropped from a queue. `deliver`, `ready` and `tick` belong to one thread. The jobs that they return may be done in
another thread, always the same one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from typing import TYPE_CHECKING, Protocol

from sfglab.errors import SfglabError
from sfglab.units import NS_PER_S
from sfglab.view.arrivals import Arrival, capture_ns, decoded
from sfglab.view.session import Change, Changed, Display, Session
from sfglab.view.visualizer import Canvas, NotShownError, SinkError, Update

if TYPE_CHECKING:
    from sfglab.view.slot import Taken


class Surface(Canvas, Protocol):
    """A canvas with its end."""

    def settle(self, size_bytes: int) -> None:
        """Take note of an update of this size; wait if too much is on its way. SinkError ends it all."""

    def close(self) -> None:
        """Send what is left and let go; again is harmless."""


Job = Callable[[Surface], None]
"""Something to draw; what cannot be drawn is noted at its display. Raises SinkError when it cannot be sent."""


def _show(display: Display, taken: Taken[Arrival], surface: Surface) -> None:
    """Draw one update of a display."""
    arrivals = taken.items.values()
    received_ns = max(arrival.received_ns for arrival in arrivals)
    surface.at(stamp_ns=taken.stamp_ns, received_ns=received_ns)
    drawn = False
    with _noted(display):
        messages = {role: decoded(arrival) for role, arrival in taken.items.items()}
        update = Update(
            messages=messages, stamp_ns=taken.stamp_ns, received_ns=received_ns, lost=taken.lost
        )
        display.visualizer.show(update, surface)
        drawn = True
    surface.settle(sum(len(arrival.cdr) for arrival in arrivals))
    if drawn:
        display.slot.count_shown()


def _tick(due: tuple[Display, ...], now_ns: int, surface: Surface) -> None:
    """Draw the displays whose tick is due."""
    surface.at(stamp_ns=now_ns, received_ns=now_ns)
    for display in due:
        with _noted(display):
            display.visualizer.tick(now_ns, surface)
    surface.settle(0)


@contextmanager
def _noted(display: Display) -> Iterator[None]:
    """Note what a visualizer raises at its display: one that fails keeps no other from being shown."""
    try:
        yield
    except SinkError:
        raise
    except NotShownError:
        pass
    except Exception as error:  # noqa: BLE001 - a visualizer may be anybody's
        display.errors += 1
        told = str(error) if isinstance(error, SfglabError) else f"{type(error).__name__}: {error}"
        display.last_error = told


class Stage:
    """The displays of a session, which may change at any time."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._wanted: dict[str, list[tuple[Display, str]]] = {}
        self._next_tick_ns: dict[str, int] = {}
        self._turn = 0
        self._close = session.listen(self._changed)

    def close(self) -> None:
        """Stop following the session; again is harmless."""
        close, self._close = self._close, lambda: None
        close()

    def deliver(self, arrival: Arrival) -> None:
        """Put a message into the queues of the displays that want it."""
        wanted = self._wanted.get(arrival.topic)
        if not wanted:
            return
        stamp_ns = capture_ns(arrival)
        for display, role in wanted:
            if display.enabled:
                display.slot.offer(role, stamp_ns, arrival, now_ns=arrival.received_ns)

    def ready(self) -> Job | None:
        """Return the next job, each display in turn, or None."""
        displays = self._session.displays
        for offset in range(len(displays)):
            index = (self._turn + offset) % len(displays)
            taken = displays[index].slot.take()
            if taken is not None:
                self._turn = index + 1
                return partial(_show, displays[index], taken)
        return None

    def tick(self, now_ns: int) -> Job | None:
        """Return what is due as the received clock goes by, or None."""
        due = tuple(d for d in self._session.displays if d.enabled and self._is_due(d, now_ns))
        return partial(_tick, due, now_ns) if due else None

    def _is_due(self, display: Display, now_ns: int) -> bool:
        """Return whether a display's tick is due, and plan its next one; a clock may jump back."""
        if not display.visualizer.tick_hz:
            return False
        period_ns = round(NS_PER_S / display.visualizer.tick_hz)
        next_ns = self._next_tick_ns.get(display.id, now_ns)
        if next_ns - period_ns <= now_ns < next_ns:
            return False
        self._next_tick_ns[display.id] = now_ns + period_ns
        return True

    def _changed(self, change: Change) -> None:
        display = change.display
        if change.what is Changed.ADDED:
            for role, topic in display.visualizer.topics.items():
                self._wanted.setdefault(topic, []).append((display, role))
        elif change.what is Changed.REMOVED:
            self._next_tick_ns.pop(display.id, None)
            for topic in set(display.visualizer.topics.values()):
                left = [(d, role) for d, role in self._wanted[topic] if d is not display]
                if left:
                    self._wanted[topic] = left
                else:
                    del self._wanted[topic]


_STEP_NS = 100_000_000
_MOST_STEPS = 3000  #: Limit of steps in a silence, which is five minutes.


def wanted_topics(session: Session) -> frozenset[str]:
    """Return the topics of all displays."""
    return frozenset(t for display in session.displays for t in display.visualizer.topics.values())


def replay(arrivals: Iterable[Arrival], session: Session, surface: Surface) -> int:
    """Draw messages, and what changes with time between; return how many; SinkError if the surface ends."""
    count, last_ns = 0, None
    with closing(Stage(session)) as stage:
        for count, arrival in enumerate(arrivals, start=1):  # noqa: B007 - counts what was read
            for now_ns in _moments(last_ns, arrival.received_ns):
                if (due := stage.tick(now_ns)) is not None:
                    due(surface)
            last_ns = arrival.received_ns
            stage.deliver(arrival)
            while (job := stage.ready()) is not None:
                job(surface)
    return count


def _moments(last_ns: int | None, now_ns: int) -> Iterator[int]:
    """Yield when ticks may be due between two messages, so that silence is seen when it began; and `now_ns`."""
    if last_ns is not None:
        yield from range(last_ns + _STEP_NS, now_ns, _STEP_NS)[:_MOST_STEPS]
    yield now_ns
