"""The deployment experiment: a run fills its claim, draws its figures, and a fault in the files would show."""

import asyncio

import pytest
from made_logs import DATA, reference

from sfglab.deploy.bundle import load_source, prepare
from sfglab.deploy.release import SOURCE, make_release
from sfglab.lab.checks.fleet_files import meaning_of
from sfglab.lab.experiments.deployment import exp
from sfglab.lab.experiments.deployment.containers import container_checks
from sfglab.lab.ledger import entries_of
from sfglab.lab.paths import find_project


def test_a_run_keeps_what_machines_are_given_and_names_what_is_not_checked(tmp_path):
    run = asyncio.run(exp.run("smoke", path=tmp_path / "run.mcap", agents=["steamdeck"]))
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.estimate.value, measured.how.value, measured.ends) == (1.0, "exact", {})
    assert "not checked here: systemd: systemd starts the unit" in measured.details
    assert [path for path in run["file"]["path"] if not meaning_of(path)] == []
    assert run["refused"]["refused"].all()
    assert len(run["refused"]) >= 10
    assert run.attachment("steamdeck/compose.yaml").startswith(b"# Agent steamdeck")


def test_one_fault_would_show():
    run = reference(exp)
    [entry] = entries_of(find_project(), run)
    assert "systemd: not measured" in entry.reason
    table = run.table("check")
    table.loc[table["group"] == "hooks", "held"] = 0
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.estimate.value, "a dry run changes nothing" in measured.reason) == (0.0, True)


def test_live_is_what_ran_and_a_part_counts_when_all_of_it_was_asked_on_a_machine():
    run = reference(exp)
    table, unchecked = run.table("check"), run.table("unchecked")
    table.loc[table["check"] == "they prepare the machine", "check"] = "hooks: as root on a machine"
    table.loc[table["group"] == "containers", "group"] = "files"
    unchecked.loc[unchecked["group"] == "hooks", "group"] = "none"
    measured = exp.measure(run)["A-DEPLOY"]
    assert (measured.how.value, measured.ends) == ("exact", {"hooks": 1.0})


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.netns
def test_agents_meet_over_their_bridges_and_routers_and_nothing_of_their_own_gets_out(tmp_path):
    source = load_source(DATA / "fleets" / "esslingen.yaml")
    pairs = prepare(source, *make_release(SOURCE, source.text), agents=("go2", "workstation"))
    rows = asyncio.run(container_checks(pairs, tmp_path))
    assert len(rows) == 3
    assert [row for row in rows if row.held < row.checked] == []
