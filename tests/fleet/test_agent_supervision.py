"""A component's table: legal paths start, retry and end a process as wanted; everything else is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.agent.supervision import REST, TRANSITIONS, Action, Input, State, Supervision, Timing
from sfglab.machine import BackOff, IllegalInputError, Machine

TIMING = Timing(start_ns=100, stop_ns=50, backoff_ns=4, backoff_max_ns=20, stable_ns=1000)


def supervision() -> Supervision:
    return Supervision("router", TIMING)


def walk(*inputs: Input) -> tuple[Supervision, list[Action | None]]:
    life = supervision()
    return life, [life.feed(i, now_ns=0) for i in inputs]


def test_a_component_starts_serves_and_ends_as_told():
    life, actions = walk(Input.BEGIN, Input.READY, Input.TOLD_TO_STOP, Input.ENDED)
    assert actions == [Action.START, Action.CANCEL_TIMER, Action.TERMINATE, Action.CANCEL_TIMER]
    assert life.state is State.STOPPED
    assert life.deadline_ns is None
    assert life.crashes == 0


def test_crashes_are_tried_again_with_doubling_waits_up_to_the_limit():
    life, _ = walk(Input.BEGIN)
    waits = []
    for _ in range(5):
        life.feed(Input.READY, now_ns=0)
        life.feed(Input.ENDED, now_ns=0)
        waits.append(life.deadline_ns)
        life.feed(Input.TIMER, now_ns=0)
    assert waits == [4, 8, 16, 20, 20]
    assert life.crashes == 5


def test_a_component_that_served_long_enough_starts_over_with_the_short_wait():
    life, _ = walk(Input.BEGIN, Input.READY, Input.ENDED, Input.TIMER, Input.ENDED, Input.TIMER)
    life.feed(Input.READY, now_ns=10)
    life.feed(Input.ENDED, now_ns=1010)
    assert life.deadline_ns == 1014


def test_the_time_before_a_crash_counts_once():
    life, _ = walk(Input.BEGIN, Input.READY)
    waits = []
    for now_ns in (5000, 6000):  # the second one never served, however long ago the first one did
        life.feed(Input.ENDED, now_ns=now_ns)
        waits.append(life.deadline_ns - now_ns)
        life.feed(Input.TIMER, now_ns=now_ns)
    assert waits == [4, 8]


def test_a_component_that_never_reports_is_ended_and_replaced_with_a_wait():
    _, actions = walk(Input.BEGIN, Input.TIMER, Input.TIMER, Input.ENDED, Input.TIMER)
    assert actions == [Action.START, Action.TERMINATE, Action.KILL, Action.BACK_OFF, Action.START]


def test_a_component_that_exits_before_it_ever_served_is_given_up():
    life, _ = walk(Input.BEGIN)
    assert life.ended(willingly=True, now_ns=0) is Action.GIVE_UP
    assert life.state is State.FAILED


def test_a_component_that_is_killed_before_it_ever_served_is_tried_again():
    life, _ = walk(Input.BEGIN)
    assert life.ended(willingly=False, now_ns=0) is Action.BACK_OFF


def test_a_component_that_has_served_is_tried_again_however_it_ends():
    life, _ = walk(Input.BEGIN, Input.READY, Input.ENDED, Input.TIMER)
    assert life.ended(willingly=True, now_ns=0) is Action.BACK_OFF


@pytest.mark.parametrize(
    "prefix",
    [
        (),
        (Input.BEGIN,),
        (Input.BEGIN, Input.READY),
        (Input.BEGIN, Input.TIMER),
        (Input.BEGIN, Input.ENDED),
        (Input.BEGIN, Input.REFUSED),
    ],
)
def test_told_to_stop_ends_wherever_it_stands(prefix):
    life, _ = walk(*prefix, Input.TOLD_TO_STOP)
    if life.state is State.STOPPING:
        life.feed(Input.ENDED, now_ns=0)
    assert life.state in REST
    assert life.deadline_ns is None
    assert life.feed(Input.TOLD_TO_STOP, now_ns=0) is None


def test_told_again_or_not_ending_in_time_it_is_ended_by_force():
    for last in (Input.TOLD_TO_STOP, Input.TIMER):
        _, actions = walk(Input.BEGIN, Input.READY, Input.TOLD_TO_STOP, last)
        assert actions[-1] is Action.KILL


def test_told_to_stop_while_it_is_replaced_keeps_the_deadline_of_its_end():
    life, _ = walk(Input.BEGIN, Input.TIMER, Input.TOLD_TO_STOP)
    assert life.state is State.STOPPING
    assert life.deadline_ns == TIMING.stop_ns


def test_every_state_is_reached_and_only_rest_has_no_way_out():
    assert {s for s, _ in TRANSITIONS.values()} | {State.NEW} == set(State)
    for state in State:
        ways_out = {after for (before, _), (after, _) in TRANSITIONS.items() if before is state} - {state}
        assert bool(ways_out) == (state not in REST)


@given(st.lists(st.sampled_from(list(Input)), max_size=40))
def test_any_input_in_any_state_is_a_listed_transition_or_refused_without_effect(inputs):
    life = supervision()
    processes = 0  # START makes one, ENDED and REFUSED take one away
    for given_input in inputs:
        if given_input in (Input.READY, Input.ENDED, Input.REFUSED) and not processes:
            continue  # the caller reports only on processes that exist
        before, deadline = life.state, life.deadline_ns
        if (before, given_input) not in TRANSITIONS:
            with pytest.raises(IllegalInputError, match=f"router in {before.name}: given {given_input.name}"):
                life.feed(given_input, now_ns=0)
            assert (life.state, life.deadline_ns) == (before, deadline)
            continue
        action = life.feed(given_input, now_ns=0)
        processes += (action is Action.START) - (given_input in (Input.ENDED, Input.REFUSED))
        assert 0 <= processes <= 1, "one process a component"
    assert (processes == 0) == (life.state in REST | {State.NEW, State.BACKING_OFF})


@given(st.lists(st.integers(min_value=0, max_value=3000), max_size=60))
def test_waits_stay_within_their_bounds_and_start_over_exactly_after_a_stable_time(lasted):
    backoff = BackOff(first_ns=4, limit_ns=20, stable_ns=1000)
    before = 0
    for count, lasted_ns in enumerate(lasted, start=1):
        wait_ns = backoff.next_ns(lasted_ns)
        proved = lasted_ns >= 1000
        assert wait_ns == (4 if proved or not before else min(2 * before, 20))
        assert backoff.failures == count
        before = wait_ns


def test_a_refusal_names_machine_state_and_what_is_allowed():
    machine = Machine("router", TRANSITIONS, State.NEW, wait_ns=lambda _action, _now_ns: None)
    assert machine.allows(Input.BEGIN)
    with pytest.raises(IllegalInputError) as caught:
        machine.feed(Input.READY, now_ns=0)
    assert str(caught.value) == "router in NEW: given READY, allowed are BEGIN, TOLD_TO_STOP"
    assert caught.value.allowed == (Input.BEGIN, Input.TOLD_TO_STOP)
