"""The life of one decoding pipeline as a table: when it starts, lingers, stops and is tried again.

Everything that decides whether a pipeline exists stands here (paper A, section 4.3, Fig. 4: defer until a
local subscriber appears, release when the last one leaves; the recovery from a crash is ours). Knows
states, inputs and actions; refuses to know processes, topics, sockets and clocks: the caller passes
`now_ns` and carries the actions out.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from sfglab.errors import SfglabError

__all__ = ["TRANSITIONS", "Action", "IllegalInputError", "Input", "Lifecycle", "State", "Timing"]


class State(Enum):
    """Where a pipeline stands."""

    IDLE = auto()
    """The stream is known; nobody wants it; nothing runs."""
    STARTING = auto()
    """A pipeline was asked for and has not reported yet."""
    RUNNING = auto()
    """The pipeline is up."""
    LINGERING = auto()
    """The last subscriber left a moment ago; the pipeline is kept in case one returns."""
    STOPPING = auto()
    """The pipeline was told to end."""
    RESTARTING = auto()
    """The pipeline was told to end, and is wanted again."""
    BACKING_OFF = auto()
    """The pipeline died while wanted; the next try waits."""
    LEAVING = auto()
    """The stream was withdrawn; the pipeline was told to end."""
    GONE = auto()
    """The stream was withdrawn and nothing runs."""


class Input(Enum):
    """What can happen to a pipeline."""

    WANTED = auto()
    """The first local subscriber appeared."""
    UNWANTED = auto()
    """The last local subscriber left."""
    STARTED = auto()
    """The pipeline reports that it is up."""
    ENDED = auto()
    """The pipeline is gone, as told or by a crash."""
    TIMER = auto()
    """The armed timer ran out."""
    WITHDRAWN = auto()
    """The remote agent or its stream is no longer known."""


class Action(Enum):
    """What the caller has to do after a transition."""

    START = auto()
    """Start the pipeline and arm the start timer."""
    STOP = auto()
    """Tell the pipeline to end and arm the stop timer."""
    KILL = auto()
    """The pipeline does not end as told: end it by force."""
    LINGER = auto()
    """Arm the linger timer."""
    BACK_OFF = auto()
    """Arm the back-off timer."""
    CANCEL_TIMER = auto()
    """Nothing is waited for any more."""


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


class IllegalInputError(SfglabError, RuntimeError):
    """An input that cannot happen in this state; the state stays as it was.

    Attributes:
        state: The state, unchanged.
        given: The input that does not fit.
    """

    def __init__(self, state: State, given: Input) -> None:
        self.state = state
        self.given = given
        allowed = sorted(i.name for s, i in TRANSITIONS if s is state)
        super().__init__(
            f"pipeline in {state.name}: given {given.name}, allowed are {', '.join(allowed) or 'none'}"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long a pipeline waits for what, in nanoseconds.

    Attributes:
        start_ns: A pipeline that has not reported after this long is ended and started anew.
        stop_ns: A pipeline that was told to end and has not after this long is ended by force.
        linger_ns: How long a pipeline outlives its last subscriber.
        backoff_ns: Wait before the first new try after a crash; it doubles with each further crash.
        backoff_max_ns: The longest wait between tries.
        stable_ns: A pipeline that ran this long has proved itself: the next crash waits `backoff_ns` again.
    """

    start_ns: int = 10_000_000_000
    stop_ns: int = 2_000_000_000
    linger_ns: int = 1_000_000_000
    backoff_ns: int = 100_000_000
    backoff_max_ns: int = 5_000_000_000
    stable_ns: int = 10_000_000_000


class Lifecycle:
    """One pipeline's state, its timer and its count of crashes.

    Args:
        timing: The waits.

    Attributes:
        state: Where the pipeline stands.
        crashes: How often it ended although it was wanted.
        deadline_ns: When `Input.TIMER` is due, on the caller's clock; None while nothing is waited for.
    """

    def __init__(self, timing: Timing) -> None:
        self.state = State.IDLE
        self.crashes = 0
        self.deadline_ns: int | None = None
        self._timing = timing
        self._backoff_ns = timing.backoff_ns
        self._running_since_ns = 0

    def feed(self, given: Input, *, now_ns: int) -> Action | None:
        """Take one input and return what the caller has to do.

        Args:
            given: What happened.
            now_ns: The caller's clock in nanoseconds.

        Raises:
            IllegalInputError: The input cannot happen in this state.
        """
        before = self.state
        if (before, given) not in TRANSITIONS:
            raise IllegalInputError(before, given)
        self.state, action = TRANSITIONS[before, given]
        if action is not None:
            self.deadline_ns = self._deadline(action, now_ns)
        if given is Input.STARTED and self.state is State.RUNNING:
            self._running_since_ns = now_ns
        return action

    def due(self, now_ns: int) -> bool:
        """Return whether the timer has run out: the caller then feeds `Input.TIMER`."""
        return self.deadline_ns is not None and now_ns >= self.deadline_ns

    def _deadline(self, action: Action, now_ns: int) -> int | None:
        if action is Action.START:
            return now_ns + self._timing.start_ns
        if action is Action.STOP:
            return now_ns + self._timing.stop_ns
        if action is Action.LINGER:
            return now_ns + self._timing.linger_ns
        if action is Action.BACK_OFF:
            return now_ns + self._next_backoff_ns(now_ns)
        return None

    def _next_backoff_ns(self, now_ns: int) -> int:
        proved = self._running_since_ns and now_ns - self._running_since_ns >= self._timing.stable_ns
        wait_ns = self._timing.backoff_ns if proved else self._backoff_ns
        self._backoff_ns = min(2 * wait_ns, self._timing.backoff_max_ns)
        self._running_since_ns = 0
        self.crashes += 1
        return wait_ns
