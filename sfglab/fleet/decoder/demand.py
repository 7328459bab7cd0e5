"""Demand for decoded streams and the life of a pipeline as a table: paper A, section 4.3, Fig. 4.

The decoder monitors graph events to track local subscriptions, defers until one appears and releases when the
last one leaves; the recovery from a crash is ours. Everything that decides whether a pipeline exists stands
here. Refuses to know processes, sockets and clocks: the caller passes `now_ns` and carries the actions out.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING

from sfglab.bus.api import EndpointAdded, EndpointKind
from sfglab.machine import BackOff, Machine

if TYPE_CHECKING:
    from sfglab.bus.api import EndpointEvent, Transport


class Demand:
    """The local subscriptions of all topics, by topic and transport."""

    def __init__(self) -> None:
        self._subscriptions: dict[str, dict[bytes, Transport]] = {}

    def feed(self, event: EndpointEvent) -> str | None:
        """Take one graph event.

        Args:
            event: An endpoint that appeared, changed or went.

        Returns:
            The topic whose demand may have changed; None for events that are no subscription's.
        """
        endpoint = event.endpoint
        if endpoint.kind is not EndpointKind.SUBSCRIPTION:
            return None
        known = self._subscriptions.setdefault(endpoint.topic, {})
        if isinstance(event, EndpointAdded):
            known[endpoint.gid] = endpoint.transport
        else:
            known.pop(endpoint.gid, None)
        if not known:
            del self._subscriptions[endpoint.topic]
        return endpoint.topic

    def transports(self, topic: str) -> frozenset[Transport]:
        """Return the transports by which a topic is wanted; empty when nobody subscribes."""
        return frozenset(self._subscriptions.get(topic, {}).values())

    def count(self, topic: str) -> int:
        """Return how many local subscriptions a topic has."""
        return len(self._subscriptions.get(topic, {}))


class State(Enum):
    """Where a pipeline stands."""

    IDLE = auto()  #: The stream is known; nobody wants it; nothing runs.
    STARTING = auto()  #: A pipeline was asked for and has not reported yet.
    RUNNING = auto()  #: The pipeline is up.
    LINGERING = auto()  #: The last subscriber left a moment ago; the pipeline is kept in case one returns.
    STOPPING = auto()  #: The pipeline was told to end.
    RESTARTING = auto()  #: The pipeline was told to end, and is wanted again.
    BACKING_OFF = auto()  #: The pipeline died while wanted; the next try waits.
    LEAVING = auto()  #: The stream was withdrawn; the pipeline was told to end.
    GONE = auto()  #: The stream was withdrawn and nothing runs.


class Input(Enum):
    """What can happen to a pipeline."""

    WANTED = auto()  #: The first local subscriber appeared.
    UNWANTED = auto()  #: The last local subscriber left.
    STARTED = auto()  #: The pipeline reports that it is up.
    ENDED = auto()  #: The pipeline is gone, as told or by a crash.
    TIMER = auto()  #: The armed timer ran out.
    WITHDRAWN = auto()  #: The remote agent or its stream is no longer known.


class Action(Enum):
    """What the caller has to do after a transition."""

    START = auto()  #: Start the pipeline and arm the start timer.
    STOP = auto()  #: Tell the pipeline to end and arm the stop timer.
    KILL = auto()  #: The pipeline does not end as told: end it by force.
    LINGER = auto()  #: Arm the linger timer.
    BACK_OFF = auto()  #: Arm the back-off timer.
    CANCEL_TIMER = auto()  #: Nothing is waited for any more.


_S, _I, _A = State, Input, Action

TRANSITIONS: dict[tuple[State, Input], tuple[State, Action | None]] = {
    (_S.IDLE, _I.WANTED): (_S.STARTING, _A.START),
    (_S.IDLE, _I.UNWANTED): (_S.IDLE, None),
    (_S.IDLE, _I.WITHDRAWN): (_S.GONE, None),
    (_S.STARTING, _I.STARTED): (_S.RUNNING, _A.CANCEL_TIMER),
    (_S.STARTING, _I.UNWANTED): (_S.STOPPING, _A.STOP),
    (_S.STARTING, _I.ENDED): (_S.BACKING_OFF, _A.BACK_OFF),
    (_S.STARTING, _I.TIMER): (_S.RESTARTING, _A.STOP),
    (_S.STARTING, _I.WITHDRAWN): (_S.LEAVING, _A.STOP),
    (_S.RUNNING, _I.UNWANTED): (_S.LINGERING, _A.LINGER),
    (_S.RUNNING, _I.ENDED): (_S.BACKING_OFF, _A.BACK_OFF),
    (_S.RUNNING, _I.WITHDRAWN): (_S.LEAVING, _A.STOP),
    (_S.LINGERING, _I.WANTED): (_S.RUNNING, _A.CANCEL_TIMER),
    (_S.LINGERING, _I.TIMER): (_S.STOPPING, _A.STOP),
    (_S.LINGERING, _I.ENDED): (_S.IDLE, _A.CANCEL_TIMER),
    (_S.LINGERING, _I.WITHDRAWN): (_S.LEAVING, _A.STOP),
    (_S.STOPPING, _I.WANTED): (_S.RESTARTING, None),
    # A pipeline that reports between the order to end and its end changes nothing.
    (_S.STOPPING, _I.STARTED): (_S.STOPPING, None),
    (_S.STOPPING, _I.ENDED): (_S.IDLE, _A.CANCEL_TIMER),
    (_S.STOPPING, _I.TIMER): (_S.STOPPING, _A.KILL),
    (_S.STOPPING, _I.WITHDRAWN): (_S.LEAVING, None),
    (_S.RESTARTING, _I.UNWANTED): (_S.STOPPING, None),
    (_S.RESTARTING, _I.STARTED): (_S.RESTARTING, None),
    (_S.RESTARTING, _I.ENDED): (_S.STARTING, _A.START),
    (_S.RESTARTING, _I.TIMER): (_S.RESTARTING, _A.KILL),
    (_S.RESTARTING, _I.WITHDRAWN): (_S.LEAVING, None),
    (_S.BACKING_OFF, _I.TIMER): (_S.STARTING, _A.START),
    (_S.BACKING_OFF, _I.UNWANTED): (_S.IDLE, _A.CANCEL_TIMER),
    (_S.BACKING_OFF, _I.WITHDRAWN): (_S.GONE, _A.CANCEL_TIMER),
    (_S.LEAVING, _I.STARTED): (_S.LEAVING, None),
    (_S.LEAVING, _I.WANTED): (_S.LEAVING, None),
    (_S.LEAVING, _I.UNWANTED): (_S.LEAVING, None),
    (_S.LEAVING, _I.ENDED): (_S.GONE, _A.CANCEL_TIMER),
    (_S.LEAVING, _I.TIMER): (_S.LEAVING, _A.KILL),
}
"""(state, input) -> (next state, action). What is not listed is illegal and changes nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long a pipeline waits for what, in nanoseconds."""

    #: A pipeline that has not reported after this long is ended and started anew.
    start_ns: int = 10_000_000_000
    #: A pipeline that was told to end and has not after this long is ended by force.
    stop_ns: int = 2_000_000_000
    linger_ns: int = 1_000_000_000  #: How long a pipeline outlives its last subscriber.
    #: Wait before the first new try after a crash; it doubles with each further crash.
    backoff_ns: int = 100_000_000
    backoff_max_ns: int = 5_000_000_000  #: The longest wait between tries.
    #: A pipeline that ran this long has proved itself: the next crash waits `backoff_ns` again.
    stable_ns: int = 10_000_000_000


class Lifecycle(Machine[State, Input, Action]):
    """One pipeline's state, its timer and its count of crashes.

    Args:
        timing: The waits.
    """

    def __init__(self, timing: Timing) -> None:
        super().__init__("pipeline", TRANSITIONS, State.IDLE, wait_ns=self._timer_ns)
        self._timing = timing
        self._running_since_ns: int | None = None
        self._backoff = BackOff(
            first_ns=timing.backoff_ns, limit_ns=timing.backoff_max_ns, stable_ns=timing.stable_ns
        )

    @property
    def crashes(self) -> int:
        """How often the pipeline ended although it was wanted."""
        return self._backoff.failures

    def feed(self, given: Input, *, now_ns: int) -> Action | None:
        """Take one input and return what the caller has to do.

        Args:
            given: What happened.
            now_ns: The caller's clock in nanoseconds.

        Raises:
            IllegalInputError: The input cannot happen in this state.
        """
        action = super().feed(given, now_ns=now_ns)
        if given is Input.STARTED and self.state is State.RUNNING:
            self._running_since_ns = now_ns
        return action

    def _timer_ns(self, action: Action, now_ns: int) -> int | None:
        timing = self._timing
        if action is Action.BACK_OFF:
            lasted_ns = 0 if self._running_since_ns is None else now_ns - self._running_since_ns
            self._running_since_ns = None
            return self._backoff.next_ns(lasted_ns)
        waits = {
            Action.START: timing.start_ns,
            Action.STOP: timing.stop_ns,
            Action.LINGER: timing.linger_ns,
        }
        return waits.get(action)
