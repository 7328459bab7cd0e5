"""The core claims the hardware-mapped topic before it sends: without that step it deadlocks."""

import pytest

from sfglab.lab.experiments.gateways import exp
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import TABLE, Drive, Input, Move, Row, Table
from sfglab.soc.gateway_world import Bound


def table_without_claim() -> Table:
    """The table in which every transition to the claim leads to where a granted claim leads."""
    sends = {}
    for state, row in TABLE.items():
        if row.drive is Drive.CLAIM_HMT:
            sends[state] = row.moves[Input.GRANTED].to
    table = {}
    for state, row in TABLE.items():
        moves = {}
        for given, move in row.moves.items():
            moves[given] = Move(sends.get(move.to, move.to), move.latch)
        table[state] = Row(row.drive, moves)
    return table


@pytest.mark.parametrize("bound", exp.config().bounds, ids=str)
def test_the_core_without_its_claim_step_deadlocks(bound):
    found = explore(bound, table_without_claim())
    assert found.counterexample.property.startswith("deadlock: ")
    drives = {TABLE[state].drive for state in found.visited}
    assert Drive.CLAIM_HMT not in drives


def test_a_port_that_stores_every_message_from_hardware_needs_no_claim():
    assert explore(Bound(port_messages=4), table_without_claim()).counterexample is None
