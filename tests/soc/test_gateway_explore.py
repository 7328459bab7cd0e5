"""Every interleaving of gateway core and surroundings (C-FSM): nothing lost, doubled, echoed or stuck."""

import re

import pytest
from mutated_table import mutated

from sfglab.errors import SfglabError
from sfglab.lab.experiments.gateways.experiment import SMALL
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import Input, State, transitions
from sfglab.soc.gateway_world import Bound

BOUNDS = [
    *SMALL,
    Bound(port_messages=4),
    Bound(software=(3,), hardware=(0,)),
    Bound(software=(0,), hardware=(3,)),
    Bound(software=(2, 1), hardware=(1, 1)),
    Bound(software=(1,), hardware=(1, 1, 1)),
    Bound(software=(2,), hardware=(1,), subscribers=4),
]


@pytest.mark.parametrize("bound", BOUNDS, ids=str)
def test_within_the_bound_every_interleaving_delivers_everything_once_in_order_without_echo(bound):
    found = explore(bound)
    assert found.counterexample is None
    if bound == Bound():
        assert (found.worlds, found.steps) == (2490, 5648), "as recorded"
    missing = set(State) - found.visited
    if not bound.echoes:
        assert missing == {State.DROP_HMT, State.DROP_HMT_HOLDING}
    elif all(bound.totals):
        assert missing <= {State.DROP_HMT_HOLDING}  # takes two messages from software


@pytest.mark.parametrize(
    ("state", "given", "target", "violated"),
    [
        ("FILTER_SMT", "OWN", "CLAIM", "echoed to the side that it came from"),
        ("FILTER_SMT", "FOREIGN", "REQUEST", "asks for the next message before .* lost"),
        ("FILTER_HMT", "FOREIGN", "DROP_HMT", "lost"),
        ("TO_MEMORY", "DONE", "PUBLISH", "PUBLISH_WAIT has no transition for ANSWERED"),
        ("PUBLISH", "SENT", "REQUEST", "POLL_OSIF has no transition for PUBLISHED"),
        ("PUBLISH_WAIT", "PUBLISHED", "PUBLISH", "publishes an output message that nobody wrote"),
        ("TO_HMT", "DONE", "POLL_OSIF", "deadlock"),
        ("TO_MEMORY", "DONE", "POLL_OSIF", "overwrites 1.0 before it is published"),
        ("POLL_HMT", "OFFERED", "POLL_OSIF", "livelock"),
        ("DROP_HMT", "DONE", "REQUEST", "asked for a message while a request is outstanding"),
    ],
)
def test_a_mutated_transition_is_caught(state, given, target, violated):
    table = mutated(State[state], Input[given], State[target])
    found = explore(Bound(), table).counterexample
    assert re.search(violated, found.property)


@pytest.mark.slow
def test_of_all_mutated_transitions_only_three_pass_and_these_change_nothing_but_the_polling():
    passed = set()
    for (state, given), target in transitions().items():
        for other in set(State) - {target}:
            if explore(Bound(), mutated(state, given, other)).counterexample is None:
                passed.add((state, given, other))
    assert passed == {
        (State.REQUEST, Input.SENT, State.POLL_HMT),
        (State.DROP_HMT, Input.DONE, State.POLL_HMT),
        (State.DROP_HMT_HOLDING, Input.DONE, State.FILTER_SMT),
    }


def test_a_delegate_that_ignores_calls_deadlocks_and_one_that_answers_twice_confuses_the_core():
    deaf = explore(Bound(listens_while_blocked=False)).counterexample
    assert deaf.property.startswith("deadlock")
    lines = str(explore(Bound(answers_once=False)).counterexample).splitlines()
    assert lines[0] == "PUBLISH_WAIT_HOLDING has no transition for CANCELLED"
    assert lines[1] == "  1  software publisher 0 publishes 0.0"
    assert lines[-1].endswith("gateway PUBLISH_WAIT_HOLDING --CANCELLED--> ?")


def test_a_limit_is_kept_and_named():
    with pytest.raises(SfglabError, match="more than 100 worlds"):
        explore(Bound(), limit=100)
