"""Mutants of the gateway core's table."""

from sfglab.soc.gateway import TABLE, Row, Transition


def mutated(state, given, target, table=TABLE):
    """The table in which an input in one state leads to another state."""
    row = table[state]
    changed = Transition(target, row.transitions[given].loads)
    return {**table, state: Row(row.action, {**row.transitions, given: changed})}
