"""One stream's replay as a table: when the kept packets are sent, and when not.

Pure. Knows whether somebody reads the replay and the waits in between; refuses to know packets and topics.
"""

from __future__ import annotations

from enum import Enum, auto

from sfglab.fleet.machine import Machine


class State(Enum):
    """Where a stream's replay stands."""

    IDLE = auto()
    """Nobody reads it; nothing is written."""
    SETTLING = auto()
    """The first reader came a moment ago; the way to whoever stands behind it is still being connected."""
    SERVING = auto()
    """The group was sent; every packet follows as it comes."""


class Input(Enum):
    """What can happen to a replay."""

    READ = auto()
    """The first reader appeared."""
    UNREAD = auto()
    """The last reader left."""
    TIMER = auto()
    """The armed timer ran out."""


class Action(Enum):
    """What the caller has to do after a transition."""

    SETTLE = auto()
    """Arm the timer."""
    CANCEL = auto()
    """Nothing is waited for any more."""
    BURST = auto()
    """Send all that is kept."""
    RENEW = auto()
    """Forget what was sent, so that the next reader does not hear it."""


_S, _I, _A = State, Input, Action

TRANSITIONS: dict[tuple[State, Input], tuple[State, Action | None]] = {
    (_S.IDLE, _I.READ): (_S.SETTLING, _A.SETTLE),
    (_S.SETTLING, _I.TIMER): (_S.SERVING, _A.BURST),
    (_S.SETTLING, _I.UNREAD): (_S.IDLE, _A.CANCEL),
    (_S.SERVING, _I.UNREAD): (_S.IDLE, _A.RENEW),
}
"""(state, input) -> (next state, action). What is not listed is illegal."""


def session(name: str, *, settle_ns: int) -> Machine[State, Input, Action]:
    """Return the machine of one stream's replay.

    Args:
        name: What it stands for, in messages.
        settle_ns: How long the connections on the way to a reader get, nanoseconds.
    """

    def wait_ns(action: Action, _: int) -> int | None:
        return settle_ns if action is Action.SETTLE else None

    return Machine(name, TRANSITIONS, State.IDLE, wait_ns=wait_ns)
