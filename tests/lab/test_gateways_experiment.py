"""The experiment on the gateway core and the mapping: it fills its claims, and a broken core is seen."""

from made_logs import ran

from sfglab.lab.bench import Bench
from sfglab.lab.experiments.gateways import exp, unclaimed
from sfglab.soc.exploration import explore
from sfglab.soc.gateway import TABLE, Drive, Input, Move, Row, State
from sfglab.soc.gateway_world import Bound


def test_a_core_that_does_not_claim_fails_the_claim(tmp_path, monkeypatch):
    moves = TABLE[State.FILTER_SMT].moves
    bent = {**moves, Input.FOREIGN: Move(State.TO_HMT, moves[Input.FOREIGN].latch)}
    monkeypatch.setitem(TABLE, State.FILTER_SMT, Row(TABLE[State.FILTER_SMT].drive, bent))
    run = ran(exp, tmp_path / "a.mcap")
    assert exp.measure(run)["C-FSM"].estimate.value < 1
    assert run["exploration"]["violation"].str.contains("deadlock").any()


def test_a_port_that_stores_all_that_hardware_sends_needs_no_claim(tmp_path):
    run = ran(exp, tmp_path / "a.mcap", bounds=(Bound(), Bound(port_messages=4)))
    assert list(run["unclaimed"]["violation"] == "") == [False, True]
    assert (
        "1 of 2 bounds are violated (deadlock: "
        in exp.measure(run)["C-FSM"].details["beyond the text"]
    )


def test_the_table_without_the_claim_differs_from_the_core_s_in_nothing_else():
    table = unclaimed(TABLE)
    claims = {state for state, row in TABLE.items() if row.drive is Drive.CLAIM_HMT}
    changed = {
        (s, i)
        for s, row in TABLE.items()
        for i, move in row.moves.items()
        if table[s].moves[i] != move
    }
    assert changed == {
        (s, i) for s, row in TABLE.items() for i, move in row.moves.items() if move.to in claims
    }
    assert not claims & explore(Bound(), table).visited


def test_a_log_of_before_is_read_and_says_nothing_of_it(tmp_path, monkeypatch):
    write = Bench.write
    monkeypatch.setattr(
        Bench, "write", lambda *a, **k: None if a[1] == "unclaimed" else write(*a, **k)
    )
    measured = exp.measure(ran(exp, tmp_path / "a.mcap"))["C-FSM"]
    assert measured.estimate.value == 1
    assert "beyond the text" not in measured.details
