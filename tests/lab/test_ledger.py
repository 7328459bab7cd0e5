"""The log that counts for claims, unreadable logs, and the origin in the sidecars of saved figures."""

import asyncio
import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from reference import keep_findings

from sfglab.errors import SfglabError
from sfglab.lab.claims import Verdict, render
from sfglab.lab.experiments.naming import exp
from sfglab.lab.findings import kept_findings
from sfglab.lab.ledger import (
    compute_ledger,
    find_log,
    history,
    redraw_figures,
)
from sfglab.lab.ledger_page import chosen_of, citation, page_html
from sfglab.lab.paths import Project
from sfglab.lab.runs import COMPLETION, new_log
from sfglab.record import LogWriter

LEDGER = Path(__file__).parents[2] / "data" / "claims.yaml"
PACKAGE = Path(__file__).parents[2] / "sfglab"


@pytest.fixture
def project(tmp_path):
    (tmp_path / "data" / "reference").mkdir(parents=True)
    shutil.copy(LEDGER, tmp_path / "data" / "claims.yaml")
    return Project(root=tmp_path)


def touch(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


def finished(path: Path, profile: str, **other) -> Path:
    with LogWriter(path) as log:
        log.write_metadata(
            COMPLETION, {"profile": profile, "changed": [], "explored": False, **other}
        )
    return path


def test_the_log_that_counts_is_the_asked_profile_else_the_newest_that_counts_else_the_reference(
    project,
):
    folder = project.runs / "logs" / "naming"
    reference = finished(project.reference_logs / "naming.mcap", "quick")
    finished(folder / "20260109T000003-smoke.mcap", "smoke")
    finished(folder / "20260109T000004-quick.mcap", "quick", changed=["source"])
    finished(folder / "20260109T000005-quick.mcap", "quick", explored=True)
    touch(folder / "20260109T000006-quick.mcap.part")
    touch(folder / "20260109T000007-quick.mcap").write_bytes(b"no log")
    assert find_log(project, "naming") == reference
    paper = finished(folder / "20260101T000000-paper.mcap", "paper")
    quick = finished(folder / "20260102T000000-quick.mcap", "quick")
    assert find_log(project, "naming") == quick
    assert find_log(project, "naming", profile="paper") == paper
    assert find_log(project, "naming", committed=True) == reference
    reference.unlink()
    finished(reference, "smoke")
    assert find_log(project, "naming", committed=True) is None


def test_new_logs_never_meet(project, monkeypatch):
    monkeypatch.setattr("sfglab.lab.runs.time.strftime", lambda *_: "20260101T000000")
    first = new_log(project, "naming", "quick")
    touch(first.with_name(f"{first.name}.part"))
    assert new_log(project, "naming", "quick") != first


def test_figures_and_verdicts_come_from_logs_alone_and_an_unreadable_one_costs_its_own_claims(
    project, caplog
):
    path = new_log(project, "naming", "quick")
    log = asyncio.run(exp.run("quick", path=path)).log
    broken = touch(project.reference_logs / "decode_once.mcap")
    broken.write_bytes(b"no log")
    entries = {e.claim.id: e for e in compute_ledger(project)}
    assert broken.name in caplog.text
    broken.unlink()
    assert entries["A-FQN"].verdict is Verdict.REPRODUCED
    assert entries["A-FQN"].log == project.relative(log)
    assert entries["A-CPU-SFG"].verdict is Verdict.NOT_YET
    assert redraw_figures(project) == {}, "a run replaces no figure of the repository"
    assert [each.log for each in history(project) if each.measured] == [
        f"{project.relative(log)}: counts"
    ]
    shutil.copy(log, project.reference_logs / "naming.mcap")
    log.unlink()
    keep_findings(project, "naming", project.reference_logs / "naming.mcap")
    [joined] = [each for each in compute_ledger(project) if each.runs]
    assert (joined.claim.id, len(joined.runs), joined.verdict) == ("A-FQN", 2, Verdict.REPRODUCED)
    logs = [each.log for each in history(project) if each.measured]
    assert logs == ["data/reference/naming.mcap: counts", "data/reference/again/naming_1.json"]
    files = redraw_figures(project)["naming"]
    before = {path.suffix: path.read_bytes() for path in files}
    assert {path.suffix: path.read_bytes() for path in redraw_figures(project)["naming"]} == before
    assert {"experiment", "config", "log", "log_sha256", "run", "shown"} <= set(
        json.loads(before[".json"])
    )


def test_the_page_is_filtered_by_paper_and_verdict(project):
    ledger = compute_ledger(project)
    of_b = chosen_of(ledger, paper="B")
    whole, filtered = page_html(project, ledger), page_html(project, of_b)
    row = '<tr data-paper="B" data-verdict='
    assert filtered.count(row) == len(of_b) == whole.count(row)
    assert len(chosen_of(ledger, verdict="not yet")) == len(ledger)
    assert not chosen_of(ledger, "B", "deviates")


def test_a_filtered_page_says_as_the_whole_one_which_deviations_are_favourable():
    whole = Project(root=PACKAGE.parent)
    ledger = compute_ledger(whole, committed=True)
    of_ledger = {entry.claim.id: entry.direction for entry in ledger}
    deviating = chosen_of(ledger, verdict="deviates")
    assert {of_ledger[entry.claim.id] for entry in deviating} >= {"favourable", "unfavourable"}
    alone = compute_ledger(whole, committed=True, only=[entry.claim.id for entry in deviating])
    assert [entry.direction for entry in alone] == [entry.direction for entry in deviating]
    assert "deviates</b><br>favourable" in page_html(whole, deviating)


def test_a_citation_has_value_interval_runs_verdict_log_commit_and_paper():
    whole = Project(root=PACKAGE.parent)
    [entry] = compute_ledger(whole, committed=True, only=["A-CPU-OURS"])
    digest = hashlib.sha256((whole.root / entry.log).read_bytes()).hexdigest()[:16]
    said = citation(whole, entry)
    parts = (
        entry.value,
        entry.unit,
        "median of 3 runs",
        "accepted: at least 65",
        "better",
        digest,
        "commit ",
        "SFG-ROS",
    )
    assert [part for part in parts if part not in said] == []


def test_a_value_that_covers_computed_checks_as_well_is_not_shown_as_live_alone():
    whole = Project(root=Path(__file__).parents[2])
    names = ["A-NET-RULES", "A-VICON", "A-PLAN", "A-DEPLOY", "A-FQN", "A-HEARTBEAT"]
    ledger = compute_ledger(whole, committed=True, only=names)
    shown = {entry.claim.id: entry.measured.origins for entry in ledger}
    expected = dict.fromkeys(names[:4], "live and computed")
    assert shown == expected | {"A-FQN": "computed", "A-HEARTBEAT": "live"}
    assert render(ledger).count("live and computed") == 4


@pytest.fixture
def copy(project, tmp_path):
    """A copy of the package, and the committed log of one experiment."""
    shutil.copytree(PACKAGE, tmp_path / "sfglab", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(LEDGER.parent / "reference" / "naming.mcap", project.reference_logs)
    return tmp_path


def claim_by(root: Path) -> dict:
    """Return a claim as the command prints it, by the copy of the package."""
    environment = os.environ | {"PYTHONPATH": str(root), "SFGLAB_ROOT": str(root)}
    command = [sys.executable, "-P", "-m", "sfglab", "claims", "--json"]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    [found] = [entry for entry in json.loads(done.stdout) if entry["id"] == "A-FQN"]
    return found


def test_kept_findings_follow_log_claims_and_the_modules_of_the_experiment(project, copy):
    cached = project.runs / "cache" / "naming" / "naming.json"
    experiments = copy / "sfglab" / "lab" / "experiments"
    first = claim_by(copy)

    def is_kept_after(change, file):
        """Return whether findings that are marked are used after a change to a file."""
        kept = json.loads(cached.read_text())
        kept["findings"]["origin"] = "kept"
        cached.write_text(json.dumps(kept))
        file.write_text(change(file.read_text()))
        return claim_by(copy)["origin"] == "kept"

    def more(text):
        return text + "\nCHANGED = 1\n"

    assert is_kept_after(more, experiments / "gateways" / "__init__.py")
    assert not is_kept_after(more, copy / "sfglab" / "names" / "__init__.py")
    unit = "share of names that hold"
    assert not is_kept_after(lambda text: text.replace(unit, "share"), project.claims)
    assert claim_by(copy) == first | {"unit": "share"}
    (project.reference_logs / "naming.mcap").write_bytes(b"no log")
    assert claim_by(copy)["verdict"] == "not yet"


def test_kept_findings_are_not_used_after_a_log_of_the_user_is_another(project):
    log = project.runs / "logs" / "naming" / "a.mcap"
    log.parent.mkdir(parents=True)
    shutil.copy(LEDGER.parent / "reference" / "naming.mcap", log)
    assert kept_findings(project, "naming", log).measured
    log.write_bytes(b"no log")
    with pytest.raises(SfglabError):
        kept_findings(project, "naming", log)


def test_a_damaged_file_of_the_cache_is_ignored(project):
    log = project.reference_logs / "naming.mcap"
    shutil.copy(LEDGER.parent / "reference" / "naming.mcap", log)
    file = project.runs / "cache" / "naming" / "naming.json"
    findings = kept_findings(project, "naming", log)
    whole = file.read_text()
    for damaged in (whole[:50], "[]", "{}"):
        file.write_text(damaged)
        assert kept_findings(project, "naming", log) == findings
        assert file.read_text() == whole
