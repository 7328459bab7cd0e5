"""A machine to press follows its own table; what the table refuses is said, and recorded runs are stepped."""

from pathlib import Path

import pytest

from sfglab.bus.actions.goals import TRANSITIONS as GOALS
from sfglab.bus.actions.goals import GoalStatus
from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Input, State
from sfglab.fleet.gop_cache import TRANSITIONS as REPLAY
from sfglab.fleet.gop_cache import State as ReplayState
from sfglab.lab.experiments import lifecycle
from sfglab.lab.explore import Automaton, transition_part

pytest.importorskip("anywidget")
REFERENCE = Path(__file__).parents[2] / "data" / "reference" / "lifecycle.mcap"
TABLES = [(TRANSITIONS, State.UNKNOWN), (REPLAY, ReplayState.IDLE), (GOALS, GoalStatus.ACCEPTED)]


@pytest.mark.parametrize(("table", "start"), TABLES, ids=["life cycle", "replay", "goal"])
def test_every_press_does_what_the_table_says_in_the_present_state_or_is_refused(table, start):
    machine = Automaton("machine", table, start, lambda *_: {}, size=(3, 2))
    inputs = dict.fromkeys(given for _, given in table)
    states = dict.fromkeys(state for state, _ in table)
    edge_of = {given: transition_part(source, given) for source, given in table}
    for state in states:
        for given in inputs:
            machine.press(state.name)
            assert machine.moment.state is state
            machine.press(edge_of[given])
            entry = table.get((state, given), state)
            assert machine.moment.state is (entry[0] if isinstance(entry, tuple) else entry)
            refused = (state, given) not in table
            assert ("allowed are" in machine.said) is refused
            assert machine.moment.taken == (None if refused else (state, given))
            assert refused or machine.moment.color([(state, given)]) != machine.moment.color([])


def test_every_transition_and_state_of_the_life_cycle_is_drawn_and_says_what_it_does():
    machine = lifecycle.press_lifecycle()
    parts = [transition_part(*key) for key in TRANSITIONS] + [state.name for state in State]
    assert not [part for part in parts if f'id="press:{part}"' not in machine._figure.svg]
    titles = machine._figure.titles
    assert titles["LOST/HEARD"] == "HEARD in LOST leads to ACTIVE: RETURNED"
    assert set(titles) == set(parts)


def test_a_recorded_run_is_stepped_left_by_hand_and_undone():
    run = lifecycle.exp.load(REFERENCE)
    machine = lifecycle.press_states(run)
    walker = "walker, seen by station"
    machine.choice.value = walker
    moves = run["move"].query("agent == 'walker'").sort_values("t_ns")
    assert machine.at.max == len(moves)
    for at, after in enumerate(moves["after"], start=1):
        machine.at.value = at
        assert machine.moment.state.name == after
    machine.press(transition_part(State.UNKNOWN, Input.HEARD))
    assert machine.moment.state is State.QUERYING
    machine.back.click()
    assert machine.moment.state.name == moves["after"].iloc[-1]
    machine.choice.value = "by hand"
    assert machine.moment.state is State.UNKNOWN
    assert machine.at.disabled
