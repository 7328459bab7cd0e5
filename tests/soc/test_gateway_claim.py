"""The core claims the hardware-mapped topic before it sends: without that step it deadlocks."""

import pytest
from mutated_table import mutated

from sfglab.lab.experiments.gateways.experiment import SMALL
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import TABLE, State, transitions
from sfglab.soc.gateway_world import Bound

WITHOUT_CLAIM = TABLE
for (state, given), target in transitions().items():
    if target is State.CLAIM:  # the transfer follows, as if the claim were granted
        WITHOUT_CLAIM = mutated(state, given, State.TO_HMT, WITHOUT_CLAIM)


@pytest.mark.parametrize("bound", [*SMALL, Bound(software=(3,), hardware=(3,))], ids=str)
def test_without_its_claim_step_a_transfer_waits_for_a_message_that_waits_for_the_core(bound):
    found = explore(bound, WITHOUT_CLAIM)
    fault = found.counterexample
    assert fault.property == "deadlock: messages are in flight and no step is possible"
    assert fault.last.state is State.TO_HMT
    assert fault.last.hmt is not None
    assert any(step.startswith("hardware publisher") for step in fault.trace)
    assert State.CLAIM not in found.visited
