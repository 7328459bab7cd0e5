"""The experiment on the gateway core and the mapping: it fills its claims, and a broken core is seen."""

from __future__ import annotations

from pathlib import Path

import pytest

from sfglab.lab.experiments import gateways
from sfglab.soc.gateway import TABLE, Input, Move, Row, State

ROOT = Path(__file__).parents[2]
SMOKE = gateways.Config.of_profile("smoke")


@pytest.fixture(autouse=True)
def _project(monkeypatch):
    monkeypatch.setenv("SFGLAB_ROOT", str(ROOT))


def test_a_run_fills_its_claims_and_draws_its_figures(tmp_path):
    log = gateways.run(SMOKE, tmp_path / "a.mcap")
    measured = gateways.measure_claims(log)
    assert measured["C-FSM"].estimate.value == 1
    assert measured["C-MAP"].estimate.value == 3
    assert measured["C-MAP"].details["edges, by stage"] == "10 -> 8 -> 3"
    assert set(gateways.figures(log)) == {"gateway_core", "graph_mapping"}


def test_a_core_that_does_not_claim_fails_the_claim(tmp_path, monkeypatch):
    moves = TABLE[State.FILTER_SMT].moves
    bent = {**moves, Input.FOREIGN: Move(State.TO_HMT, moves[Input.FOREIGN].latch)}
    monkeypatch.setitem(TABLE, State.FILTER_SMT, Row(TABLE[State.FILTER_SMT].drive, bent))
    log = gateways.run(SMOKE, tmp_path / "a.mcap")
    assert gateways.measure_claims(log)["C-FSM"].estimate.value < 1
    assert gateways.load_results(log).explorations["violation"].str.contains("deadlock").any()


def test_unknown_profiles_are_refused():
    with pytest.raises(gateways.ConfigError, match="given 'long'"):
        gateways.Config.of_profile("long")
