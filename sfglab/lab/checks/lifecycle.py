"""Rules of a remote agent's life cycle, written apart from the discoverer's table: paper A, section 4.2.

They say of any state and input what must follow, so that a wrong row, and a wrong move in a log, is found.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from sfglab.fleet.discovery.lifecycle import Action, Asking, Input, Lifecycle, State, Told, diagram
from sfglab.lab.checks import Checks
from sfglab.machine import IllegalInputError

if TYPE_CHECKING:
    Outcome = tuple[State, tuple[Action, ...]] | None

checks = Checks("lifecycle")
_I, _A = Input, Action


def ruled(state: State, given: Input) -> Outcome:
    """Return the next state and what has to be done, in order; None where the input cannot happen."""
    (told, asking), lost, new = state.value, state is State.LOST, state is State.UNKNOWN
    asked, waits = asking is Asking.QUERYING, asking is Asking.BACKING_OFF
    can_happen = {
        _I.ANSWERED: asked,
        _I.ANSWERED_ANEW: asked and told is not Told.NOTHING,
        _I.FAILED: asked,
        _I.RETRY: waits,
        _I.SILENT: not lost,
        _I.EXPIRED: lost or (waits and told is Told.NOTHING),
    }
    if not can_happen.get(given, True) or (new and given is not _I.HEARD):
        return None
    ask = (told, Asking.QUERYING)
    after = State(
        {
            _I.HEARD: ask if new else (Told.PRESENT, Asking.NO) if lost else state.value,
            _I.CHANGED: state.value if asked or waits else ask,
            _I.FAILED: (told, Asking.BACKING_OFF),
            _I.SILENT: (told if told is Told.NOTHING else Told.LOST, Asking.NO),
            _I.EXPIRED: State.UNKNOWN.value,
            **dict.fromkeys((_I.RETRY, _I.RESTARTED), ask),
            **dict.fromkeys((_I.ANSWERED, _I.ANSWERED_ANEW), (Told.PRESENT, Asking.NO)),
        }[given]
    )
    abandoned = asked and given in {_I.SILENT, _I.RESTARTED}
    due = {
        _A.ABANDON: abandoned,
        _A.QUERY: after.asking is Asking.QUERYING and (abandoned or not asked),
        _A.BACK_OFF: given is _I.FAILED,
        _A.FORGET: after is State.UNKNOWN,
        **dict.fromkeys(_announced(told, given, after.told), True),
    }
    return after, tuple(action for action, is_due in due.items() if is_due)


def _announced(told: Told, given: Input, after: Told) -> tuple[Action, ...]:
    """Return the discovery event, if any: what consumers must hear to know what `after` says they do."""
    if told is after and given not in {_I.ANSWERED, _I.ANSWERED_ANEW}:
        return ()
    if after is not Told.PRESENT:
        return (_A.LOST,) if after is Told.LOST else ()
    news = {Told.NOTHING: _A.DISCOVERED, Told.PRESENT: _A.UPDATED, Told.LOST: _A.RETURNED}
    return (_A.RESTARTED if given is _I.ANSWERED_ANEW else news[told],)


@checks.each(
    "from each state each input leads where the rules say, or nowhere",
    lambda *_: product(State, Input),
)
def _follows_the_rules(pair: tuple[State, Input]) -> bool:
    life, drawn = (
        Lifecycle("go2"),
        {(e.source, e.given): (e.target, e.actions) for e in diagram()[1]},
    )
    life.state, given = pair
    try:
        done = life.feed(given)
    except IllegalInputError:
        return ruled(*pair) is drawn.get(pair) is None and life.state is pair[0]
    return (life.state, done) == ruled(*pair) == drawn.get(pair)
