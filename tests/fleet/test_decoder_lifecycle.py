"""The pipeline's table: legal paths do what Fig. 4 says, everything else is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.decoder.demand import (
    TRANSITIONS,
    Action,
    Input,
    Lifecycle,
    State,
    Timing,
)
from sfglab.machine import IllegalInputError

TIMING = Timing(start_ns=100, linger_ns=10, backoff_ns=4, backoff_max_ns=20, stable_ns=1000)


def walk(*inputs: Input, lifecycle: Lifecycle | None = None) -> tuple[Lifecycle, list[Action | None]]:
    lifecycle = lifecycle or Lifecycle(TIMING)
    return lifecycle, [lifecycle.feed(i, now_ns=0) for i in inputs]


def test_first_subscriber_starts_and_last_one_releases():
    lifecycle, actions = walk(Input.WANTED, Input.STARTED, Input.UNWANTED, Input.TIMER, Input.ENDED)
    assert actions == [Action.START, Action.CANCEL_TIMER, Action.LINGER, Action.STOP, Action.CANCEL_TIMER]
    assert lifecycle.state is State.IDLE
    assert lifecycle.deadline_ns is None


def test_a_subscriber_that_returns_within_the_linger_keeps_the_pipeline():
    lifecycle, actions = walk(Input.WANTED, Input.STARTED, Input.UNWANTED, Input.WANTED)
    assert actions[-1] is Action.CANCEL_TIMER
    assert lifecycle.state is State.RUNNING
    assert not lifecycle.due(10**12)


def test_a_crash_is_tried_again_with_doubling_waits_up_to_the_limit():
    lifecycle = Lifecycle(TIMING)
    lifecycle.feed(Input.WANTED, now_ns=0)
    waits = []
    for _ in range(5):
        lifecycle.feed(Input.ENDED, now_ns=0)
        waits.append(lifecycle.deadline_ns)
        lifecycle.feed(Input.TIMER, now_ns=0)
    assert waits == [4, 8, 16, 20, 20]
    assert lifecycle.crashes == 5


def test_a_pipeline_that_ran_long_enough_starts_over_with_the_short_wait():
    lifecycle = Lifecycle(TIMING)
    lifecycle.feed(Input.WANTED, now_ns=0)
    for now_ns in (1, 2):
        lifecycle.feed(Input.ENDED, now_ns=now_ns)
        lifecycle.feed(Input.TIMER, now_ns=now_ns)
    lifecycle.feed(Input.STARTED, now_ns=5)
    lifecycle.feed(Input.ENDED, now_ns=2000)
    assert lifecycle.deadline_ns == 2004


def test_a_pipeline_that_never_reports_is_ended_and_started_anew():
    lifecycle, actions = walk(Input.WANTED, Input.TIMER, Input.ENDED)
    assert actions == [Action.START, Action.STOP, Action.START]
    assert lifecycle.state is State.STARTING


def test_demand_that_returns_while_stopping_starts_a_new_pipeline_after_the_old_one_is_gone():
    _, actions = walk(Input.WANTED, Input.UNWANTED, Input.WANTED, Input.ENDED)
    assert actions == [Action.START, Action.STOP, None, Action.START]


def test_a_pipeline_that_does_not_end_as_told_is_ended_by_force():
    lifecycle, actions = walk(Input.WANTED, Input.UNWANTED, Input.TIMER, Input.ENDED)
    assert actions == [Action.START, Action.STOP, Action.KILL, Action.CANCEL_TIMER]
    assert lifecycle.state is State.IDLE


@pytest.mark.parametrize("prefix", [(), (Input.WANTED,), (Input.WANTED, Input.STARTED)])
def test_a_withdrawn_stream_ends_gone(prefix):
    lifecycle, _ = walk(*prefix, Input.WITHDRAWN)
    if lifecycle.state is State.LEAVING:
        lifecycle.feed(Input.ENDED, now_ns=0)
    assert lifecycle.state is State.GONE


def test_every_state_but_gone_has_a_way_out_and_every_state_is_reached():
    assert {s for s, _ in TRANSITIONS} == set(State) - {State.GONE}
    assert {s for s, _ in TRANSITIONS.values()} == set(State)


@given(st.lists(st.sampled_from(list(Input)), max_size=40))
def test_any_input_in_any_state_is_a_listed_transition_or_refused_without_effect(inputs):
    lifecycle = Lifecycle(TIMING)
    running = 0  # pipelines that exist: START makes one, ENDED takes one away
    for given_input in inputs:
        if given_input in (Input.STARTED, Input.ENDED) and not running:
            continue  # the caller reports only on pipelines that exist
        before = lifecycle.state
        if (before, given_input) not in TRANSITIONS:
            with pytest.raises(IllegalInputError, match=given_input.name):
                lifecycle.feed(given_input, now_ns=0)
            assert lifecycle.state is before
            continue
        action = lifecycle.feed(given_input, now_ns=0)
        running += (action is Action.START) - (given_input is Input.ENDED)
        assert 0 <= running <= 1, "exactly one pipeline a stream"
    assert (running == 0) == (lifecycle.state in (State.IDLE, State.BACKING_OFF, State.GONE))
