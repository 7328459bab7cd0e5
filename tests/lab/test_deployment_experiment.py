"""The deployment experiment: a run fills its claim, draws its figures, and a fault in the files would show."""

import asyncio

import pytest

from sfglab.deploy.bundle import load_source, prepare
from sfglab.deploy.release import SOURCE, make_release
from sfglab.lab.checks.fleet_files import meaning_of
from sfglab.lab.experiments.deployment import exp
from sfglab.lab.experiments.deployment.containers import container_checks
from sfglab.lab.ledger import entries_of
from sfglab.lab.paths import find_project

REFERENCE = SOURCE / "data" / "reference" / "deployment.mcap"
ESSLINGEN = SOURCE / "data" / "fleets" / "esslingen.yaml"


def test_a_run_fills_its_claim_draws_its_figures_and_keeps_what_machines_are_given(tmp_path):
    run = asyncio.run(exp.run("smoke", path=tmp_path / "run.mcap", agents=["steamdeck"]))
    measured = exp.measure(run)["A-DEPLOY"]
    assert measured.estimate.value == 1.0, measured.reason
    assert measured.how.value == "exact"
    left_out = "not checked here: systemd: systemd starts the unit"
    assert (measured.ends, left_out in measured.details) == ({}, True)
    assert set(exp.figures(run)) == {"deployment_layers", "deployment_checks"}
    assert [path for path in run["file"]["path"] if not meaning_of(path)] == []
    assert run["refused"]["refused"].all()
    assert len(run["refused"]) >= 10
    assert run.attachment("steamdeck/compose.yaml").startswith(b"# Agent steamdeck")


def test_the_reference_run_fills_the_claim_and_one_fault_would_show():
    run = exp.load(REFERENCE)
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.estimate.value, measured.how.value) == (1.0, "live")
    (entry,) = entries_of(find_project(), run)
    assert (entry.verdict.value, "systemd: not measured" in entry.reason) == ("undecided", True)
    table = run.table("check")
    table.loc[table["group"] == "hooks", "held"] = 0
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.estimate.value, "a dry run changes nothing" in measured.reason) == (0.0, True)


def test_live_is_what_ran_and_a_part_counts_when_all_of_it_was_asked_on_a_machine():
    run = exp.load(REFERENCE)
    table = run.table("check")
    table.loc[table["check"] == "they prepare the machine", "check"] = "hooks: as root on a machine"
    table.loc[table["group"] == "containers", "group"] = "files"
    unchecked = run.table("unchecked")
    unchecked.loc[unchecked["group"] == "hooks", "group"] = "none"
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.how.value, measured.ends) == ("exact", {"hooks": 1.0})


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.netns
def test_agents_meet_over_their_bridges_and_routers_and_nothing_of_their_own_gets_out(tmp_path):
    source = load_source(ESSLINGEN)
    pairs = prepare(source, *make_release(SOURCE, source.text), agents=("go2", "workstation"))
    rows = asyncio.run(container_checks(pairs, tmp_path))
    assert len(rows) == 3
    assert [row for row in rows if row.held < row.checked] == []
