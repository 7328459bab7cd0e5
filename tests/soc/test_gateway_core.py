"""The gateway core's table (paper C, section 3, Fig. 4): complete, and walked as the text says."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import SfglabError
from sfglab.soc.gateway import TABLE, Core, Drive, IllegalInputError, Input, Latch, State, filtered

MEETS = {
    Drive.LISTEN_OSIF: {Input.LOCATED, Input.EMPTY, Input.ANSWERED, Input.CANCELLED, Input.PUBLISHED},
    Drive.CALL_TAKE: {Input.SENT},
    Drive.CALL_CANCEL: {Input.SENT},
    Drive.CALL_PUBLISH: {Input.SENT},
    Drive.PEEK_HMT: {Input.OFFERED, Input.EMPTY},
    Drive.COMPARE_HELD: {Input.OWN, Input.FOREIGN},
    Drive.COMPARE_PORT: {Input.OWN, Input.FOREIGN},
    Drive.CLAIM_HMT: {Input.GRANTED, Input.OFFERED},
    Drive.MEMORY_TO_HMT: {Input.DONE},
    Drive.HMT_TO_MEMORY: {Input.DONE},
    Drive.HMT_TO_NOWHERE: {Input.DONE},
}
IDLE = (Input.LOCATED, Input.SENT)


def walked(*inputs: Input) -> Core:
    core = Core()
    for index, item in enumerate(inputs):
        core.feed(item, 0x1000 * (index + 1))
    return core


def drives(*inputs: Input) -> list[Drive]:
    core = walked(*IDLE)
    return [core.feed(item, 0xBEEF) for item in inputs]


def test_every_state_has_a_row_and_waits_only_for_what_its_drive_can_meet():
    assert set(TABLE) == set(State)
    for row in TABLE.values():
        assert row.moves
        assert set(row.moves) <= MEETS[row.drive]


def test_every_state_every_input_and_every_drive_is_used():
    reached = {State.START} | {move.to for row in TABLE.values() for move in row.moves.values()}
    assert reached == set(State)
    assert {given for row in TABLE.values() for given in row.moves} == set(Input)
    assert {row.drive for row in TABLE.values()} == set(Drive)


def test_registers_are_loaded_by_addresses_and_by_nothing_else():
    latches = {(s, i): m.latch for s, row in TABLE.items() for i, m in row.moves.items() if m.latch}
    assert {i for (_, i), latch in latches.items() if latch is Latch.OUTPUT} == {Input.LOCATED}
    assert {i for (_, i), latch in latches.items() if latch is Latch.HELD} == {Input.ANSWERED}
    answered = {(s, Input.ANSWERED) for s, row in TABLE.items() if Input.ANSWERED in row.moves}
    assert answered == {key for key, latch in latches.items() if latch is Latch.HELD}


def test_osif_and_hmt_are_polled_in_turn():
    assert drives(Input.EMPTY, Input.EMPTY, Input.EMPTY) == [Drive.PEEK_HMT, Drive.LISTEN_OSIF, Drive.PEEK_HMT]


def test_a_software_message_goes_to_the_hmt_and_a_new_request_follows():
    assert drives(Input.ANSWERED, Input.FOREIGN, Input.GRANTED, Input.DONE) == [
        Drive.COMPARE_HELD,
        Drive.CLAIM_HMT,
        Drive.MEMORY_TO_HMT,
        Drive.CALL_TAKE,
    ]


def test_a_hardware_message_is_written_then_the_request_cancelled_then_published():
    assert drives(
        Input.EMPTY,
        Input.OFFERED,
        Input.FOREIGN,
        Input.DONE,
        Input.SENT,
        Input.CANCELLED,
        Input.SENT,
        Input.PUBLISHED,
    ) == [
        Drive.PEEK_HMT,
        Drive.COMPARE_PORT,
        Drive.HMT_TO_MEMORY,
        Drive.CALL_CANCEL,
        Drive.LISTEN_OSIF,
        Drive.CALL_PUBLISH,
        Drive.LISTEN_OSIF,
        Drive.CALL_TAKE,
    ]


def test_a_message_that_the_cancel_returns_is_forwarded_before_the_next_request():
    core = walked(*IDLE, Input.EMPTY, Input.OFFERED, Input.FOREIGN, Input.DONE, Input.SENT, Input.ANSWERED)
    assert core.held == 0x8000
    following = [Input.SENT, Input.PUBLISHED, Input.FOREIGN, Input.GRANTED, Input.DONE]
    assert [core.feed(item) for item in following] == [
        Drive.LISTEN_OSIF,
        Drive.COMPARE_HELD,
        Drive.CLAIM_HMT,
        Drive.MEMORY_TO_HMT,
        Drive.CALL_TAKE,
    ]
    assert core.held == 0x8000


def test_own_messages_are_discarded_on_both_sides():
    assert drives(Input.ANSWERED, Input.OWN)[-1] is Drive.CALL_TAKE
    assert drives(Input.EMPTY, Input.OFFERED, Input.OWN, Input.DONE)[2:] == [
        Drive.HMT_TO_NOWHERE,
        Drive.LISTEN_OSIF,
    ]


def test_the_filter_compares_ids():
    assert filtered(7, 7) is Input.OWN
    assert filtered(8, 7) is Input.FOREIGN


def test_an_illegal_input_names_state_and_alternatives_and_changes_nothing():
    core = walked(*IDLE)
    with pytest.raises(
        IllegalInputError, match=r"POLL_OSIF: given DONE, allowed are ANSWERED, EMPTY"
    ) as caught:
        core.feed(Input.DONE)
    assert isinstance(caught.value, SfglabError)
    assert (caught.value.state, core.state) == (State.POLL_OSIF, State.POLL_OSIF)


@given(st.lists(st.tuples(st.sampled_from(Input), st.integers(0, 2**64 - 1)), max_size=60))
def test_any_input_in_any_state_moves_as_the_table_says_or_is_refused(schedule):
    core = Core()
    for item, value in schedule:
        before = (core.state, core.output, core.held)
        move = TABLE[core.state].moves.get(item)
        assert (item in core.waits_for) is (move is not None)
        if move is None:
            with pytest.raises(IllegalInputError):
                core.feed(item, value)
            assert (core.state, core.output, core.held) == before
            continue
        assert core.feed(item, value) is core.drive is TABLE[move.to].drive
        assert core.state is move.to
        assert core.output == (value if move.latch is Latch.OUTPUT else before[1])
        assert core.held == (value if move.latch is Latch.HELD else before[2])
