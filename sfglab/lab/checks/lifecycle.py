"""Rules of a remote agent's life cycle, written independently of the discoverer's table: paper A, section 4.2.

The rules give the outcome of every state and input. They detect a wrong row of the table and a wrong
transition in a log.
"""

from __future__ import annotations

from sfglab.fleet.discovery.lifecycle import Action, Announced, Input, QueryState, State

NEWS = {
    Announced.NOTHING: Action.DISCOVERED,
    Announced.PRESENT: Action.UPDATED,
    Announced.LOST: Action.RETURNED,
}
"""Discovery event after an answer, by what was announced before."""


Outcome = tuple[State, tuple[Action, ...]]


def ruled(state: State, given: Input) -> Outcome | None:
    """Return the next state and the actions in order; None if the input cannot happen in this state."""
    if state is State.UNKNOWN:
        return (State.QUERYING, (Action.QUERY,)) if given is Input.HEARD else None
    if given in {Input.HEARD, Input.CHANGED, Input.RESTARTED}:
        return _after_heartbeat(state, given)
    if given in {Input.SILENT, Input.EXPIRED}:
        return _without_heartbeat(state, given)
    return _after_query(state, given)


def _after_heartbeat(state: State, given: Input) -> Outcome:
    querying = State((state.announced, QueryState.QUERYING))
    if given is Input.RESTARTED:
        return querying, (*_abandon(state), Action.QUERY)
    if given is Input.CHANGED and state.query is QueryState.NONE:
        return querying, (Action.QUERY,)
    if given is Input.HEARD and state is State.LOST:
        return State.ACTIVE, (Action.RETURNED,)
    return state, ()


def _without_heartbeat(state: State, given: Input) -> Outcome | None:
    is_useless = state in {State.LOST, State.BACKING_OFF}
    if given is Input.EXPIRED:
        return (State.UNKNOWN, (Action.FORGET,)) if is_useless else None
    if state is State.LOST:
        return None
    abandon = _abandon(state)
    match state.announced:
        case Announced.NOTHING:
            return State.UNKNOWN, (*abandon, Action.FORGET)
        case Announced.PRESENT:
            return State.LOST, (*abandon, Action.LOST)
        case Announced.LOST:
            return State.LOST, abandon


def _after_query(state: State, given: Input) -> Outcome | None:
    announced, query = state.announced, state.query
    if given is Input.RETRY and query is QueryState.BACKING_OFF:
        return State((announced, QueryState.QUERYING)), (Action.QUERY,)
    if query is not QueryState.QUERYING:
        return None
    if given is Input.FAILED:
        return State((announced, QueryState.BACKING_OFF)), (Action.BACK_OFF,)
    if given is Input.ANSWERED:
        return State.ACTIVE, (NEWS[announced],)
    if given is Input.ANSWERED_ANEW and announced is not Announced.NOTHING:
        return State.ACTIVE, (Action.RESTARTED,)
    return None


def _abandon(state: State) -> tuple[Action, ...]:
    return (Action.ABANDON,) if state.query is QueryState.QUERYING else ()
