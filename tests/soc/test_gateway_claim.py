"""The core claims the hardware-mapped topic before it sends: without that step it deadlocks."""

import pytest

from sfglab.lab.experiments.gateways import exp
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import TABLE, Row, State, Table, Transition
from sfglab.soc.gateway_world import Bound


def table_without_claim() -> Table:
    """The table in which each transition to the claim leads to the transfer, as if it were granted."""
    table = {}
    for state, row in TABLE.items():
        changed = {}
        for given, transition in row.transitions.items():
            target = transition.target
            if target is State.CLAIM:
                target = State.TO_HMT
            changed[given] = Transition(target, transition.loads)
        table[state] = Row(row.action, changed)
    return table


@pytest.mark.parametrize("bound", exp.config().bounds, ids=str)
def test_the_core_without_its_claim_step_deadlocks(bound):
    found = explore(bound, table_without_claim())
    assert found.counterexample.property.startswith("deadlock: ")
    assert State.CLAIM not in found.visited


@pytest.mark.parametrize(("port_messages", "stuck"), [(1, True), (2, False)])
def test_a_port_that_stores_every_message_that_hardware_may_send_needs_no_claim(
    port_messages, stuck
):
    bound = Bound(port_messages=port_messages, echoes=False)  # hardware sends two
    assert (explore(bound, table_without_claim()).counterexample is not None) is stuck
    with_echoes = Bound(port_messages=4)  # and the core's own two messages
    assert explore(with_echoes, table_without_claim()).counterexample is None


def test_the_deadlock_is_a_transfer_that_waits_for_a_message_that_waits_for_the_core():
    found = explore(Bound(), table_without_claim()).counterexample
    assert found.property == "deadlock: messages are in flight and no step is possible"
    assert found.last.state is State.TO_HMT
    assert found.last.hmt is not None
    assert "hardware publisher 1 offers 1.0" in found.trace
