"""The gateway core's table (paper C, section 3, Fig. 4): as the text describes it, and drawn whole."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from sfglab.soc.gateway import TABLE, Input, State, transitions
from sfglab.soc.gateway_drawing import BOX_HEIGHT, BOX_WIDTH, draw_core, positions


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
    state = State.START
    found = []
    for name in ("LOCATED", "SENT", *inputs.split()):
        state = transitions()[state, Input[name]]
        found.append(TABLE[state].action.name)
    assert found[2:] == actions.split()


def test_an_arrow_passes_over_no_state():
    centres = positions()
    for (source, _), target in transitions().items():
        arrow = np.linspace(centres[source], centres[target], 100)
        for state in set(State) - {source, target}:
            x, y = np.abs(arrow - centres[state]).T
            assert not ((x < BOX_WIDTH / 2) & (y < BOX_HEIGHT / 2)).any(), (source, target, state)


def test_every_state_and_every_transition_is_drawn_once():
    axes = Figure().add_subplot()
    assert set(draw_core(axes)) == {*State, *((transition,) for transition in transitions())}
    texts = [text.get_text() for text in axes.texts]
    assert len(texts) == 2 * len(State) + len(transitions())
    assert texts.count("filter SMT") == 1
