"""The experiment on the gateway core and the mapping: it fills its claims, and a broken core is seen."""

from made_logs import ran

from sfglab.lab.experiments.gateways import exp
from sfglab.soc.gateway import TABLE, Input, Row, State, Transition


def test_a_core_that_does_not_claim_fails_the_claim(tmp_path, monkeypatch):
    row = TABLE[State.FILTER_SMT]
    changed = {**row.transitions, Input.FOREIGN: Transition(State.TO_HMT)}
    monkeypatch.setitem(TABLE, State.FILTER_SMT, Row(row.action, changed))
    run = ran(exp, tmp_path / "a.mcap")
    claim = exp.measure(run)["C-FSM"]
    assert claim.estimate.value < 1
    assert "deadlock" in claim.reason
    assert run["exploration"]["violation"].str.contains("deadlock").any()
