"""State machines as transition tables, the life cycle of a process that is restarted after crashes, and back-off."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Generic, TypeVar

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Mapping

S = TypeVar("S", bound=Enum)
I = TypeVar("I", bound=Enum)  # noqa: E741 - stands beside S and A, for inputs
A = TypeVar("A", bound=Enum)
T = TypeVar("T")


class IllegalInputError(SfglabError, RuntimeError):
    """An input that is illegal in the present state. The state is unchanged."""


def step(name: str, table: Mapping[tuple[S, I], T], state: S, given: I) -> T:
    """Return the table's entry for an input in a state.

    Args:
        name: Name of the state machine in errors.
        table: Entries by state and input.
        state: Present state.
        given: The input.

    Raises:
        IllegalInputError: The table has no entry for this input in this state.
    """
    if (state, given) not in table:
        allowed = [known.name for origin, known in table if origin is state]
        names = ", ".join(sorted(allowed)) or "none"
        raise IllegalInputError(f"{name} in {state.name}: given {given.name}, allowed: {names}")
    return table[state, given]


def transitions(
    states: type[S], inputs: type[I], actions: type[A], text: str
) -> dict[tuple[S, I], tuple[S, tuple[A, ...]]]:
    """Return a transition table from a text.

    Each line names a state, an input, the next state, and the actions in order. The result has the next state and the
    actions by state and input.
    """
    table = {}
    for line in filter(None, map(str.split, text.splitlines())):
        state, given, after, *names = line
        done = tuple(actions[name] for name in names)
        table[states[state], inputs[given]] = (states[after], done)
    return table


@dataclass(slots=True, kw_only=True)
class BackOff:
    """Waits between attempts: they double up to a limit, and start over after a successful attempt."""

    first_ns: int  #: First wait, ns.
    limit_ns: int  #: Longest wait, ns.
    #: Duration from which an attempt counts as successful, ns: the next wait is then the first one again.
    stable_ns: int
    failures: int = 0  #: Number of failed attempts.
    _doublings: int = 0

    def next_ns(self, lasted_ns: int) -> int:
        """Count the failure of an attempt that lasted for a time, ns; return the wait before the next attempt, ns."""
        self.failures += 1
        if lasted_ns >= self.stable_ns:
            self._doublings = 0
        wait_ns = min(self.first_ns << self._doublings, self.limit_ns)
        self._doublings += wait_ns < self.limit_ns
        return wait_ns


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessTiming:
    """Time limits of a process that is restarted after crashes, ns."""

    #: Time limit for the start, ns. A process that does not serve by then is replaced.
    start_ns: int = 30_000_000_000
    #: Time limit for the end, ns. A process that still runs by then is killed.
    stop_ns: int = 5_000_000_000
    #: Wait before the first restart after a crash, ns; the wait doubles with each further crash.
    backoff_ns: int = 200_000_000
    backoff_max_ns: int = 10_000_000_000  #: Longest wait before a restart, ns.
    #: Time of service after which the next crash counts as the first one, ns.
    stable_ns: int = 10_000_000_000


class ProcessLife(Generic[S, I, A]):
    """Life cycle of a process that is restarted after crashes, with increasing waits.

    The state follows a table of `transitions` with at most one action per transition; inputs that are not listed are
    illegal. An action arms the timer or, without an entry in `waits_ns`, disarms it. A transition without an action
    does not change the timer.
    """

    READY: I  #: Input for the report that the process serves.
    BACK_OFF: A  #: Action after a crash, which arms the next wait.

    def __init__(
        self,
        name: str,
        table: Mapping[tuple[S, I], tuple[S, tuple[A, ...]]],
        start: S,
        *,
        waits_ns: Mapping[A, int],
        timing: ProcessTiming,
    ) -> None:
        """Begin in a state.

        Args:
            name: Name of the process in messages.
            table: Transitions.
            start: First state.
            waits_ns: Times of the timer by the action that arms it, nanoseconds, without `BACK_OFF`.
            timing: Waits between restarts.
        """
        self.state = start  #: Present state.
        #: Time at which the timer is due, ns; None: it is not armed.
        self.deadline_ns: int | None = None
        self.was_ready = False  #: Whether the process has ever served.
        self._name = name
        self._table = table
        self._waits_ns = waits_ns
        self._backoff = BackOff(
            first_ns=timing.backoff_ns, limit_ns=timing.backoff_max_ns, stable_ns=timing.stable_ns
        )
        self._serves_since_ns: int | None = None

    @property
    def crashes(self) -> int:
        """Number of times that the process ended although it was wanted."""
        return self._backoff.failures

    def allows(self, given: I) -> bool:
        """Return whether an input can happen in the present state."""
        return (self.state, given) in self._table

    def due(self, now_ns: int) -> bool:
        """Return whether the timer has run out at a time, ns. The caller then feeds the input for this event."""
        return self.deadline_ns is not None and now_ns >= self.deadline_ns

    def feed(self, given: I, *, now_ns: int) -> A | None:
        """Process an input at a time of the caller's clock, ns, and return the action for the caller.

        Raises:
            IllegalInputError: The input is illegal in the present state.
        """
        before = self.state
        self.state, actions = step(self._name, self._table, self.state, given)
        action = next(iter(actions), None)
        if action is not None:
            wait_ns = self._wait_ns(action, now_ns)
            self.deadline_ns = None if wait_ns is None else now_ns + wait_ns
        if given is self.READY and self.state is not before:
            self.was_ready = True
            self._serves_since_ns = now_ns
        return action

    def _wait_ns(self, action: A, now_ns: int) -> int | None:
        if action is not self.BACK_OFF:
            return self._waits_ns.get(action)
        since_ns, self._serves_since_ns = self._serves_since_ns, None
        return self._backoff.next_ns(0 if since_ns is None else now_ns - since_ns)
