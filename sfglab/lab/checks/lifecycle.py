"""Rules of a remote agent's life cycle, written apart from the discoverer's table: paper A, section 4.2.

They say of any state and input what must follow, so that a wrong row, and a wrong move in a log, is found.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from sfglab.fleet.discovery.lifecycle import (
    Action,
    Announced,
    Input,
    Lifecycle,
    QueryState,
    State,
)
from sfglab.lab.checks import Checks
from sfglab.machine import IllegalInputError

if TYPE_CHECKING:
    Outcome = tuple[State, tuple[Action, ...]] | None

checks = Checks("lifecycle")
_I, _A = Input, Action


def ruled(state: State, given: Input) -> Outcome:
    """Return the next state and what has to be done, in order; None where the input cannot happen."""
    (told, query), lost, new = state.value, state is State.LOST, state is State.UNKNOWN
    asked, waits = query is QueryState.QUERYING, query is QueryState.BACKING_OFF
    can_happen = {
        _I.ANSWERED: asked,
        _I.ANSWERED_ANEW: asked and told is not Announced.NOTHING,
        _I.FAILED: asked,
        _I.RETRY: waits,
        _I.SILENT: not lost,
        _I.EXPIRED: lost or (waits and told is Announced.NOTHING),
    }
    if not can_happen.get(given, True) or (new and given is not _I.HEARD):
        return None
    ask = (told, QueryState.QUERYING)
    after = State(
        {
            _I.HEARD: ask if new else (Announced.PRESENT, QueryState.NONE) if lost else state.value,
            _I.CHANGED: state.value if asked or waits else ask,
            _I.FAILED: (told, QueryState.BACKING_OFF),
            _I.SILENT: (told if told is Announced.NOTHING else Announced.LOST, QueryState.NONE),
            _I.EXPIRED: State.UNKNOWN.value,
            **dict.fromkeys((_I.RETRY, _I.RESTARTED), ask),
            **dict.fromkeys((_I.ANSWERED, _I.ANSWERED_ANEW), (Announced.PRESENT, QueryState.NONE)),
        }[given]
    )
    abandoned = asked and given in {_I.SILENT, _I.RESTARTED}
    due = {
        _A.ABANDON: abandoned,
        _A.QUERY: after.query is QueryState.QUERYING and (abandoned or not asked),
        _A.BACK_OFF: given is _I.FAILED,
        _A.FORGET: after is State.UNKNOWN,
        **dict.fromkeys(_announced(told, given, after.announced), True),
    }
    return after, tuple(action for action, is_due in due.items() if is_due)


def _announced(told: Announced, given: Input, after: Announced) -> tuple[Action, ...]:
    """Return the discovery event, if any: what consumers must hear to know what `after` says they do."""
    if told is after and given not in {_I.ANSWERED, _I.ANSWERED_ANEW}:
        return ()
    if after is not Announced.PRESENT:
        return (_A.LOST,) if after is Announced.LOST else ()
    news = {
        Announced.NOTHING: _A.DISCOVERED,
        Announced.PRESENT: _A.UPDATED,
        Announced.LOST: _A.RETURNED,
    }
    return (_A.RESTARTED if given is _I.ANSWERED_ANEW else news[told],)


@checks.each(
    "from each state each input leads where the rules say, or nowhere",
    lambda *_: product(State, Input),
)
def _follows_the_rules(pair: tuple[State, Input]) -> bool:
    life = Lifecycle("go2")
    life.state, given = pair
    try:
        done = life.feed(given)
    except IllegalInputError:
        return ruled(*pair) is None and life.state is pair[0]
    return (life.state, done) == ruled(*pair)
