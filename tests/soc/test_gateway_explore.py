"""Every interleaving of gateway core and surroundings (C-FSM): nothing lost, doubled, echoed or stuck."""

import re

import pytest

from sfglab.errors import SfglabError
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import TABLE, Input, Move, Row, State, Table
from sfglab.soc.gateway_world import Bound


def broken(state: State, given: Input, to: State) -> Table:
    """The table with one arrow bent."""
    row = TABLE[state]
    return {**TABLE, state: Row(row.drive, {**row.moves, given: Move(to, row.moves[given].latch)})}


BOUNDS = [
    *(
        Bound(),
        Bound(subscribers=2),
        Bound(calls=2),
        Bound(port_messages=1),
        Bound(port_messages=4),
    ),
    *(Bound(software=(3,), hardware=hardware) for hardware in ((3,), (0,))),
    *(Bound(software=(2, 1), hardware=(1, 1)), Bound(software=(1,), hardware=(1, 1, 1))),
    *(Bound(software=(2,), hardware=(1,), subscribers=4), Bound(software=(0,), hardware=(3,))),
]


@pytest.mark.parametrize("bound", BOUNDS, ids=str)
def test_within_the_bound_every_interleaving_delivers_everything_once_in_order_without_echo(bound):
    found = explore(bound)
    assert found.counterexample is None
    if bound == Bound():
        assert (found.worlds, found.steps, found.depth) == (2490, 5648, 58), "as recorded"
    if all((*bound.software, *bound.hardware)):
        assert set(State) - found.visited <= {
            State.DROP_HMT_HOLDING
        }  # takes two messages from software


def test_without_echoes_the_filters_only_let_pass():
    found = explore(Bound(echoes=False))
    assert found.counterexample is None
    assert set(State) - found.visited == {State.DROP_HMT, State.DROP_HMT_HOLDING}


@pytest.mark.parametrize(
    ("state", "given", "to", "violated"),
    [
        (State.FILTER_SMT, Input.OWN, State.CLAIM, "echoed to the side that it came from"),
        (
            State.FILTER_SMT,
            Input.FOREIGN,
            State.REQUEST,
            "asks for the next message before .* lost",
        ),
        (State.FILTER_HMT, Input.FOREIGN, State.DROP_HMT, "lost"),
        (State.TO_MEMORY, Input.DONE, State.PUBLISH, "ANSWERED comes unexpected in PUBLISH_WAIT"),
        (State.PUBLISH, Input.SENT, State.REQUEST, "PUBLISHED comes unexpected in POLL_OSIF"),
        (
            State.PUBLISH_WAIT,
            Input.PUBLISHED,
            State.PUBLISH,
            "publishes an output message that nobody wrote",
        ),
        (State.TO_HMT, Input.DONE, State.POLL_OSIF, "deadlock"),
        (State.TO_MEMORY, Input.DONE, State.POLL_OSIF, "overwrites 1.0 before it is published"),
        (
            State.DROP_HMT,
            Input.DONE,
            State.REQUEST,
            "asked for a message while a request is outstanding",
        ),
    ],
)
def test_a_bent_arrow_is_caught(state, given, to, violated):
    found = explore(Bound(), broken(state, given, to)).counterexample
    assert found is not None
    assert re.search(violated, found.property)


@pytest.mark.slow
def test_of_all_arrows_bent_anywhere_only_three_pass_and_these_change_nothing_but_the_polling():
    passed = {
        (state, given, to)
        for state, row in TABLE.items()
        for given, move in row.moves.items()
        for to in set(State) - {move.to}
        if explore(Bound(), broken(state, given, to)).counterexample is None
    }
    assert passed == {
        (State.REQUEST, Input.SENT, State.POLL_HMT),
        (State.DROP_HMT, Input.DONE, State.POLL_HMT),
        (State.DROP_HMT_HOLDING, Input.DONE, State.FILTER_SMT),
    }


def test_a_core_that_sends_without_claiming_waits_forever_for_itself():
    found = explore(Bound(), broken(State.FILTER_SMT, Input.FOREIGN, State.TO_HMT)).counterexample
    assert found.property == "deadlock: messages are under way and nothing can move any more"
    assert (found.last.state, found.last.topic is None) == (State.TO_HMT, False)
    assert "hardware publisher 1 offers 1.0" in found.trace


@pytest.mark.parametrize(("port_messages", "stuck"), [(0, True), (1, True), (2, False), (3, False)])
def test_without_a_claim_the_port_stores_every_message_that_hardware_may_send_meanwhile(
    port_messages, stuck
):
    bound = Bound(port_messages=port_messages, echoes=False)  # hardware sends two
    found = explore(bound, broken(State.FILTER_SMT, Input.FOREIGN, State.TO_HMT)).counterexample
    assert (found is not None) is stuck


def test_a_delegate_that_is_deaf_deadlocks_and_one_that_answers_twice_confuses_the_core():
    assert explore(Bound(listens_while_blocked=False)).counterexample.property.startswith(
        "deadlock"
    )
    lines = str(explore(Bound(answers_once=False)).counterexample).splitlines()
    assert lines[0] == "CANCELLED comes unexpected in PUBLISH_WAIT_HOLDING"
    assert lines[1] == "  1  software publisher 0 publishes 0.0"
    assert lines[-1].endswith("gateway PUBLISH_WAIT_HOLDING --CANCELLED--> ?")


def test_a_limit_is_kept_and_named():
    with pytest.raises(SfglabError, match="more than 100 worlds"):
        explore(Bound(), limit=100)
