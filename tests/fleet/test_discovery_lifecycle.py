"""The table of Fig. 3: legal paths do what the paper says, everything else is refused, one query at a time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.discovery.lifecycle import (
    ANNOUNCEMENTS,
    TRANSITIONS,
    Action,
    Asking,
    Input,
    Lifecycle,
    State,
    Told,
    diagram,
)
from sfglab.machine import IllegalInputError
from sfglab.messages import message_type

A, In, S = Action, Input, State


def walk(*inputs: Input) -> tuple[State, list[Action]]:
    life = Lifecycle("go2")
    actions = [action for i in inputs for action in life.feed(i)]
    return life.state, actions


def test_a_heartbeat_leads_to_one_query_and_its_answer_to_discovered():
    assert walk(In.HEARD, In.HEARD, In.HEARD, In.ANSWERED) == (S.ACTIVE, [A.QUERY, A.DISCOVERED])


def test_a_query_that_fails_is_asked_again_after_a_wait():
    path = (In.HEARD, In.FAILED, In.HEARD, In.RETRY, In.ANSWERED)
    assert walk(*path) == (S.ACTIVE, [A.QUERY, A.BACK_OFF, A.QUERY, A.DISCOVERED])


@pytest.mark.parametrize("query", [(), (In.FAILED,)])
def test_an_agent_that_was_never_announced_is_forgotten_without_a_word(query):
    state, actions = walk(In.HEARD, *query, In.SILENT)
    assert state is S.UNKNOWN
    assert actions[-1] is A.FORGET
    assert not ANNOUNCEMENTS & set(actions)


def test_silence_is_lost_and_the_next_heartbeat_returned_without_a_query():
    actions = walk(In.HEARD, In.ANSWERED, In.SILENT, In.HEARD)[1]
    assert actions == [A.QUERY, A.DISCOVERED, A.LOST, A.RETURNED]


def test_another_start_is_asked_anew_and_restarted():
    state, actions = walk(In.HEARD, In.ANSWERED, In.RESTARTED, In.HEARD, In.ANSWERED_ANEW)
    assert (state, actions) == (S.ACTIVE, [A.QUERY, A.DISCOVERED, A.QUERY, A.RESTARTED])


def test_another_revision_is_asked_for_and_updated():
    state, actions = walk(In.HEARD, In.ANSWERED, In.CHANGED, In.CHANGED, In.ANSWERED)
    assert (state, actions) == (S.ACTIVE, [A.QUERY, A.DISCOVERED, A.QUERY, A.UPDATED])


def test_a_restart_during_a_query_gives_that_one_up_before_it_asks_again():
    assert walk(In.HEARD, In.RESTARTED)[1] == [A.QUERY, A.ABANDON, A.QUERY]


def test_an_agent_that_comes_back_changed_and_goes_again_is_not_lost_twice():
    _, actions = walk(In.HEARD, In.ANSWERED, In.SILENT, In.RESTARTED, In.SILENT, In.HEARD)
    assert [a for a in actions if a in ANNOUNCEMENTS] == [A.DISCOVERED, A.LOST, A.RETURNED]


def test_events_bear_the_names_of_the_message_and_all_of_them_can_happen():
    message = message_type("sfglab_interfaces/msg/AgentDiscoveryEvent")
    assert sorted(getattr(message, a.name) for a in ANNOUNCEMENTS) == [0, 1, 2, 3, 4]
    assert {a for _, actions in TRANSITIONS.values() for a in actions} == set(Action)


def test_the_states_are_the_grid_of_what_is_told_and_what_is_asked():
    assert {s.value for s in State} == {(told, asking) for told in Told for asking in Asking}
    assert {s for s, _ in TRANSITIONS} == set(State), "every state has a way out"
    assert {s for s, _ in TRANSITIONS.values()} == set(State), "every state is reached"


@pytest.mark.parametrize(
    ("state", "heard"), [(s, i) for s in State for i in (In.HEARD, In.CHANGED, In.RESTARTED)]
)
def test_a_heartbeat_is_legal_wherever_it_can_come(state, heard):
    assert ((state, heard) in TRANSITIONS) == (state is not S.UNKNOWN or heard is In.HEARD)


def test_the_table_moves_along_its_grid_as_its_actions_say():
    for (source, _), (target, actions) in TRANSITIONS.items():
        outstanding = (source.asking is Asking.QUERYING) + actions.count(A.QUERY) - actions.count(A.ABANDON)
        ended = (
            source.asking is Asking.QUERYING
            and A.ABANDON not in actions
            and target.asking is not Asking.QUERYING
        )
        assert outstanding - ended == (target.asking is Asking.QUERYING)
        told = [a for a in actions if a in ANNOUNCEMENTS]
        assert len(told) <= 1
        if told:
            assert target.told is (Told.LOST if told == [A.LOST] else Told.PRESENT)
        else:
            assert target.told is source.told or target is S.UNKNOWN


def test_the_diagram_is_the_table():
    nodes, edges = diagram()
    assert {n.state for n in nodes} == set(State)
    assert len({(n.row, n.column) for n in nodes}) == 9
    assert {(e.source, e.given): (e.target, e.actions) for e in edges} == TRANSITIONS
    assert next(e for e in edges if e.source is S.REFRESHING and e.given is In.ANSWERED_ANEW).label == (
        "answered anew / restarted"
    )
    assert next(e for e in edges if e.source is S.ACTIVE and e.given is In.HEARD).label == "heard"


@given(st.lists(st.sampled_from(list(Input)), max_size=60))
def test_any_input_in_any_state_is_a_listed_transition_or_refused_without_effect(inputs):
    life = Lifecycle("go2")
    for given_input in inputs:
        before = life.state
        if (before, given_input) in TRANSITIONS:
            life.feed(given_input)
            continue
        with pytest.raises(IllegalInputError, match=rf"agent 'go2' in {before.name}: given {given_input.name}"):
            life.feed(given_input)
        assert life.state is before
