"""The gateway core's table (paper C, section 3, Fig. 4): complete, walked as the text says, and drawn whole."""

import itertools
from collections import Counter

import pytest
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from walked_core import Core

from sfglab.soc.gateway import PLACES, TABLE, Drive, Input, Latch, State, arrows, draw_core

MEETS = {
    Drive.LISTEN_OSIF: {
        Input.LOCATED,
        Input.EMPTY,
        Input.ANSWERED,
        Input.CANCELLED,
        Input.PUBLISHED,
    },
    **{drive: {Input.SENT} for drive in (Drive.CALL_TAKE, Drive.CALL_CANCEL, Drive.CALL_PUBLISH)},
    Drive.PEEK_HMT: {Input.OFFERED, Input.EMPTY},
    **{drive: {Input.OWN, Input.FOREIGN} for drive in (Drive.COMPARE_HELD, Drive.COMPARE_PORT)},
    Drive.CLAIM_HMT: {Input.GRANTED, Input.OFFERED},
    **{
        drive: {Input.DONE}
        for drive in (Drive.MEMORY_TO_HMT, Drive.HMT_TO_MEMORY, Drive.HMT_TO_NOWHERE)
    },
}


def test_every_state_waits_for_what_its_drive_can_meet_and_every_input_and_drive_is_used():
    assert set(TABLE) == set(State)
    for row in TABLE.values():
        assert row.moves
        assert set(row.moves) <= MEETS[row.drive]
    assert {State.START} | {arrow.target for arrow in arrows()} == set(State)
    assert {arrow.given for arrow in arrows()} == set(Input)
    assert {row.drive for row in TABLE.values()} == set(Drive)


def test_registers_are_loaded_by_addresses_and_by_nothing_else():
    latches = {(i, m.latch) for row in TABLE.values() for i, m in row.moves.items()}
    assert {pair for pair in latches if pair[0] in (Input.LOCATED, Input.ANSWERED) or pair[1]} == {
        (Input.LOCATED, Latch.OUTPUT),
        (Input.ANSWERED, Latch.HELD),
    }


@pytest.mark.parametrize(
    ("inputs", "drives"),
    [
        ("EMPTY EMPTY EMPTY", "PEEK_HMT LISTEN_OSIF PEEK_HMT"),  # both sides are polled in turn
        ("ANSWERED FOREIGN GRANTED DONE", "COMPARE_HELD CLAIM_HMT MEMORY_TO_HMT CALL_TAKE"),
        (  # a hardware message is written, then the request cancelled, then it is published
            "EMPTY OFFERED FOREIGN DONE SENT CANCELLED SENT PUBLISHED",
            "PEEK_HMT COMPARE_PORT HMT_TO_MEMORY CALL_CANCEL LISTEN_OSIF CALL_PUBLISH LISTEN_OSIF CALL_TAKE",
        ),
        (  # a message that the cancel returns is forwarded before the next request
            "EMPTY OFFERED FOREIGN DONE SENT ANSWERED SENT PUBLISHED FOREIGN GRANTED DONE",
            (
                "PEEK_HMT COMPARE_PORT HMT_TO_MEMORY CALL_CANCEL LISTEN_OSIF "
                "CALL_PUBLISH LISTEN_OSIF COMPARE_HELD CLAIM_HMT MEMORY_TO_HMT CALL_TAKE"
            ),
        ),
        ("ANSWERED OWN", "COMPARE_HELD CALL_TAKE"),  # own messages are discarded on both sides
        ("EMPTY OFFERED OWN DONE", "PEEK_HMT COMPARE_PORT HMT_TO_NOWHERE LISTEN_OSIF"),
    ],
)
def test_the_core_walks_as_the_text_says(inputs, drives):
    core = Core()
    for item in ("LOCATED", "SENT"):
        core.feed(Input[item])
    found = []
    for item in inputs.split():
        assert Input[item] in core.waits_for
        found.append(core.feed(Input[item], 0xBEEF).name)
    assert found == drives.split()
    assert core.held == (0xBEEF if "ANSWERED" in inputs else 0)


def test_every_state_is_a_box_with_its_place_and_every_arrow_is_drawn_once_with_its_input():
    axes = Figure().add_subplot()
    draw_core(axes)
    assert set(PLACES) == set(State)
    assert len(set(PLACES.values())) == len(State)
    assert sum(isinstance(patch, FancyBboxPatch) for patch in axes.patches) == len(State)
    assert "filter SMT" in {text.get_text() for text in axes.texts}
    drawn = Counter(text.get_text() for text in axes.texts)
    inputs = Counter(arrow.given.name for arrow in arrows())
    assert len(arrows()) == sum(len(row.moves) for row in TABLE.values()) == 26
    assert all(drawn[n.lower()] == inputs[n] for n in ("OFFERED", "ANSWERED", "GRANTED", "FOREIGN"))


def test_no_arrow_but_the_one_with_a_detour_passes_over_a_state():
    for arrow in arrows():
        if (arrow.source, arrow.target) == (State.CANCEL_WAIT, State.PUBLISH_HOLDING):
            continue
        (x0, y0), (x1, y1) = PLACES[arrow.source], PLACES[arrow.target]
        for x, y in set(itertools.product(range(-1, 6), range(5))) - {(x0, y0), (x1, y1)}:
            between = min(x0, x1) <= x <= max(x0, x1) and min(y0, y1) <= y <= max(y0, y1)
            on_line = (x - x0) * (y1 - y0) == (y - y0) * (x1 - x0)
            assert not (between and on_line and (x, y) in PLACES.values()), arrow
