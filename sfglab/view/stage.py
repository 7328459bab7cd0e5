"""Delivery of messages to the displays of a session, jobs that draw them, and replay of a log.

The clock is the caller's: a log is replayed by its own clock, as fast as the outputs take it, and nothing is
dropped from a queue. `deliver` and `jobs` belong to one thread. The jobs may be done in another thread, always
the same one.
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
_MOST_STEPS = 3000  #: Limit of steps in a silence, which is five minutes.


class Surface(Canvas, Protocol):
    """A canvas with its end."""

    def settle(self, size_bytes: int) -> None:
        """Take note of an update of this size; wait if too much is on its way. SinkError ends it all."""

    def close(self) -> None:
        """Send what is left and let go; again is harmless."""


Job = Callable[[Surface], None]
"""Something to draw; what cannot be drawn is noted at its display. Raises SinkError when it cannot be sent."""


def _show(display: Display, taken: Taken[Arrival], surface: Surface) -> None:
    """Draw one update of a display, which counts as shown when the surface has taken it."""
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
    """Draw; note an error at the display, so that a visualizer that fails keeps no other from being shown."""
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
        """Put a message into the queues of the displays that want it."""
        wanted = self._wanted.get(arrival.topic)
        if not wanted:
            return
        stamp_ns = capture_ns(arrival)
        for display, role in wanted:
            if display.enabled:
                display.slot.offer(role, stamp_ns, arrival, now_ns=arrival.received_ns)

    def jobs(self, now_ns: int) -> Iterator[Job]:
        """Yield what is due as the received clock goes by, then what waits, each display in turn."""
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
        """Note which displays want which topic."""
        self._wanted = {}
        for display in self._session.displays:
            for role, topic in display.topics.items():
                self._wanted.setdefault(topic, []).append((display, role))


def wanted_topics(session: Session) -> frozenset[str]:
    """Return the topics of all displays."""
    return frozenset(topic for display in session.displays for topic in display.topics.values())


def replay(arrivals: Iterable[Arrival], session: Session, surface: Surface) -> None:
    """Draw messages, and what changes with time between; SinkError if the surface ends."""
    last_ns: int | None = None
    with closing(Stage(session)) as stage:
        for arrival in arrivals:
            now_ns = arrival.received_ns
            if last_ns is not None:  # so that silence is seen when it began
                for moment_ns in range(last_ns + _STEP_NS, now_ns, _STEP_NS)[:_MOST_STEPS]:
                    _do(stage, moment_ns, surface)
            last_ns = now_ns
            _do(stage, now_ns, surface)
            stage.deliver(arrival)
            _do(stage, now_ns, surface)


def _do(stage: Stage, now_ns: int, surface: Surface) -> None:
    for job in stage.jobs(now_ns):
        job(surface)
