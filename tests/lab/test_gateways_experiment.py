"""The experiment on the gateway core and the mapping: it fills its claims, and a broken core is seen."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sfglab.lab.experiments import gateways
from sfglab.lab.experiments.gateways.run import unclaimed
from sfglab.record import LogWriter
from sfglab.soc.gateway import TABLE, Bound, Drive, Input, Move, Row, State, explore

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


def test_the_claim_says_what_became_of_a_core_that_does_not_claim(tmp_path):
    log = gateways.run(SMOKE, tmp_path / "a.mcap")
    bounds = len(SMOKE.bounds)
    assert gateways.load_results(log).unclaimed["violation"].str.startswith("deadlock").sum() == bounds
    said = gateways.measure_claims(log)["C-FSM"].details["beyond the text"]
    assert f"{bounds} of {bounds} bounds are violated (deadlock: " in said


def test_a_port_that_stores_all_that_hardware_sends_needs_no_claim(tmp_path):
    roomy = replace(SMOKE, bounds=(Bound(), Bound(port_messages=4)))
    log = gateways.run(roomy, tmp_path / "a.mcap")
    assert list(gateways.load_results(log).unclaimed["violation"] == "") == [False, True]
    assert "1 of 2 bounds" in gateways.measure_claims(log)["C-FSM"].details["beyond the text"]


def test_the_table_without_the_claim_differs_from_the_core_s_in_nothing_else():
    table = unclaimed(TABLE)
    claims = {state for state, row in TABLE.items() if row.drive is Drive.CLAIM_HMT}
    changed = {(s, i) for s, row in TABLE.items() for i, move in row.moves.items() if table[s].moves[i] != move}
    assert changed == {(s, i) for s, row in TABLE.items() for i, move in row.moves.items() if move.to in claims}
    assert not claims & explore(Bound(), table).visited


def test_a_log_of_before_is_read_and_says_nothing_of_it(tmp_path, monkeypatch):
    class Before(LogWriter):
        def write_row(self, table, row, *, log_time_ns):
            if table != "unclaimed":
                super().write_row(table, row, log_time_ns=log_time_ns)

    monkeypatch.setattr(sys.modules[gateways.run.__module__], "LogWriter", Before)
    measured = gateways.measure_claims(gateways.run(SMOKE, tmp_path / "a.mcap"))["C-FSM"]
    assert measured.estimate.value == 1
    assert "beyond the text" not in measured.details
