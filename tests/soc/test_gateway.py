"""The gateway core's table (paper C, section 3, Fig. 4): complete, as the text describes it, and drawn whole."""

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
LOADS = {Input.LOCATED: Register.OUTPUT, Input.ANSWERED: Register.HELD}
"""Registers that are loaded from the inputs with an address."""


def test_every_state_waits_for_possible_inputs_loads_addresses_and_every_name_is_used():
    for row in TABLE.values():
        possible = POSSIBLE[row.action.name.split("_")[0]].split()
        assert row.transitions
        for given, transition in row.transitions.items():
            assert given.name in possible
            assert transition.loads is LOADS.get(given)
    assert {State.START, *transitions().values()} == set(State) == set(TABLE)
    assert {given for _, given in transitions()} == set(Input)
    assert {row.action for row in TABLE.values()} == set(Action)


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


def test_a_straight_arrow_passes_over_no_state_but_for_those_with_corners():
    centres = {state: np.array(centre) for state, centre in positions().items()}
    passing = set()
    for (source, _), target in transitions().items():
        start, way = centres[source], centres[target] - centres[source]
        for state in set(State) - {source, target}:
            along = (centres[state] - start) @ way / (way @ way)
            nearest = start + np.clip(along, 0, 1) * way
            if np.hypot(*(centres[state] - nearest)) < 0.3:
                passing.add((source, target))
    assert passing == set(DETOURS)


def test_every_state_and_every_transition_is_drawn_once():
    axes = Figure().add_subplot()
    assert set(draw_core(axes)) == {*State, *transitions()}
    boxes = [patch for patch in axes.patches if isinstance(patch, FancyBboxPatch)]
    assert len(boxes) == len(State) == len(set(positions().values()))
    texts = [text.get_text() for text in axes.texts]
    offered = [given for _, given in transitions() if given is Input.OFFERED]
    assert (texts.count("filter SMT"), texts.count("offered")) == (1, len(offered))
