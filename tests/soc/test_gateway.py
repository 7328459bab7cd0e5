"""The gateway core's table (paper C, section 3, Fig. 4): complete, as the text describes it, and drawn whole."""

from collections import Counter

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from walked_core import Core

from sfglab.soc.gateway import TABLE, Action, Input, Register, State, transitions
from sfglab.soc.gateway_drawing import DETOURS, draw_core, positions

POSSIBLE = {
    "LISTEN": "LOCATED EMPTY ANSWERED CANCELLED PUBLISHED",
    "CALL": "SENT",
    "PEEK": "OFFERED EMPTY",
    "COMPARE": "OWN FOREIGN",
    "CLAIM": "GRANTED OFFERED",
    "MEMORY": "DONE",
    "HMT": "DONE",
}
"""Inputs that are possible with an action, by the first word of the action's name."""


def test_every_state_waits_for_inputs_that_its_action_allows_and_every_name_is_used():
    assert set(TABLE) == set(State)
    for row in TABLE.values():
        possible = POSSIBLE[row.action.name.split("_")[0]].split()
        assert row.transitions
        assert {given.name for given in row.transitions} <= set(possible)
    assert {State.START, *transitions().values()} == set(State)
    assert {given for _, given in transitions()} == set(Input)
    assert {row.action for row in TABLE.values()} == set(Action)


def test_registers_are_loaded_from_inputs_with_an_address_and_from_no_other():
    registers = {Input.LOCATED: Register.OUTPUT, Input.ANSWERED: Register.HELD}
    for row in TABLE.values():
        for given, transition in row.transitions.items():
            assert transition.loads is registers.get(given)


@pytest.mark.parametrize(
    ("inputs", "actions"),
    [
        ("EMPTY EMPTY EMPTY", "PEEK_HMT LISTEN_OSIF PEEK_HMT"),  # both sides are polled in turn
        ("ANSWERED FOREIGN GRANTED DONE", "COMPARE_HELD CLAIM_HMT MEMORY_TO_HMT CALL_TAKE"),
        (  # a hardware message is written, then the request cancelled, then it is published
            "EMPTY OFFERED FOREIGN DONE SENT CANCELLED SENT PUBLISHED",
            "PEEK_HMT COMPARE_PORT HMT_TO_MEMORY CALL_CANCEL LISTEN_OSIF CALL_PUBLISH LISTEN_OSIF CALL_TAKE",
        ),
        (  # a message that answers the cancelled request is forwarded before the next request
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
def test_the_core_behaves_as_the_paper_s_text_says(inputs, actions):
    core = Core()
    found = []
    for name in ("LOCATED", "SENT", *inputs.split()):
        assert Input[name] in TABLE[core.state].transitions
        core.feed(Input[name], 0xBEEF)
        found.append(TABLE[core.state].action.name)
    assert found[2:] == actions.split()
    assert core.held == (0xBEEF if "ANSWERED" in inputs else 0)


def after(state, given, flags):
    """Flags (requested, stored, held) after an input, or None if the surroundings cannot give it.

    Checked for sequences of inputs of any length: the core requests a message, and publishes, only if no request
    is outstanding; it publishes only a stored message, stores one only if none is stored, and sends only a held one.
    """
    requested, stored, held = flags
    action = TABLE[state].action
    match action, given:
        case Action.CALL_TAKE, _:
            assert not requested
            requested = True
        case Action.CALL_PUBLISH, _:
            assert stored
            assert not requested
        case Action.HMT_TO_MEMORY, _:
            assert not stored
            stored = True
        case Action.MEMORY_TO_HMT, _:
            assert held
            held = False
        case _, Input.ANSWERED | Input.CANCELLED:
            if not requested:
                return None
            requested = False
            held = given is Input.ANSWERED
        case _, Input.PUBLISHED:
            stored = False
        case Action.COMPARE_HELD, Input.OWN:
            held = False
    return requested, stored, held


def test_requests_publications_and_transfers_are_safe_for_inputs_of_any_number():
    waiting = [(State.START, (False, False, False))]
    found = set(waiting)
    while waiting:
        state, flags = waiting.pop()
        for given, transition in TABLE[state].transitions.items():
            flags_after = after(state, given, flags)
            situation = (transition.target, flags_after)
            if flags_after is not None and situation not in found:
                found.add(situation)
                waiting.append(situation)
    assert len(found) == len(State), "the flags are the same whenever a state is entered"


def test_every_state_and_every_transition_is_drawn_once():
    axes = Figure().add_subplot()
    artists = draw_core(axes)
    assert set(artists) == {*State, *transitions()}
    boxes = [patch for patch in axes.patches if isinstance(patch, FancyBboxPatch)]
    assert len(boxes) == len(State) == len(set(positions().values()))
    texts = Counter(text.get_text() for text in axes.texts)
    inputs = Counter(given.name for _, given in transitions())
    assert texts["filter SMT"] == 1
    assert all(texts[name.lower()] == inputs[name] for name in ("OFFERED", "ANSWERED", "FOREIGN"))


def test_a_straight_arrow_passes_over_no_state():
    centres = positions()
    for (source, _), target in transitions().items():
        if (source, target) in DETOURS:
            continue
        start, end = np.array(centres[source]), np.array(centres[target])
        for state in set(State) - {source, target}:
            along = (centres[state] - start) @ (end - start) / ((end - start) @ (end - start))
            nearest = start + np.clip(along, 0, 1) * (end - start)
            assert np.hypot(*(centres[state] - nearest)) > 0.3, (source, target, state)
