"""Which log speaks, what becomes of an unreadable one, and what saved figures say of their origin."""

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

from sfglab.lab.claims import Verdict, render_in_full
from sfglab.lab.experiments.naming import exp
from sfglab.lab.findings import FindingsCache
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


def test_the_log_that_counts_is_the_asked_profile_else_the_newest_that_speaks_else_the_reference(
    project,
):
    folder = project.runs / "logs" / "naming"
    assert find_log(project, "naming") is None
    reference = finished(project.reference_logs / "naming.mcap", "quick")
    finished(folder / "20260109T000003-smoke.mcap", "smoke")
    finished(folder / "20260109T000004-quick.mcap", "quick", changed=["source"])
    finished(folder / "20260109T000005-quick.mcap", "quick", explored=True)
    touch(folder / "20260109T000006-quick.mcap.part")
    touch(folder / "20260109T000007-quick.mcap").write_bytes(b"no log")
    assert find_log(project, "naming") == reference
    assert find_log(project, "naming", profile="smoke") == reference
    paper = finished(folder / "20260101T000000-paper.mcap", "paper")
    quick = finished(folder / "20260102T000000-quick.mcap", "quick")
    assert find_log(project, "naming") == quick
    assert find_log(project, "naming", profile="paper") == paper
    assert find_log(project, "naming", committed=True) == reference
    reference.unlink()
    finished(reference, "smoke")
    assert find_log(project, "naming", committed=True) is None


def test_new_logs_never_meet(project):
    first = touch(new_log(project, "naming", "quick"))
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
        f"{project.relative(log)}: speaks"
    ]
    shutil.copy(log, project.reference_logs / "naming.mcap")
    log.unlink()
    kept = keep_findings(project, "naming", project.reference_logs / "naming.mcap")
    assert kept.name == "naming_1.json"
    [joined] = [each for each in compute_ledger(project) if each.runs]
    assert (joined.claim.id, len(joined.runs), joined.verdict) == ("A-FQN", 2, Verdict.REPRODUCED)
    logs = [each.log for each in history(project) if each.measured]
    assert logs == ["data/reference/naming.mcap: speaks", "data/reference/again/naming_1.json"]
    files = redraw_figures(project)["naming"]
    assert sorted(p.suffix for p in files) == [".json", ".png", ".svg"]
    before = [p.read_bytes() for p in files]
    assert [p.read_bytes() for p in redraw_figures(project)["naming"]] == before, "deterministic"
    twin = json.loads(next(p for p in files if p.suffix == ".json").read_text())
    assert {"experiment", "config", "log", "log_sha256", "run", "shown"} <= set(twin)


def test_every_claim_has_its_words_criterion_and_figures(project):
    drawn = touch(project.root / "figures" / "x.json")
    drawn.write_text(json.dumps({"experiment": "naming"}))
    ledger = compute_ledger(project)
    page = page_html(project, ledger)
    assert page.count("</td></tr>") == len(ledger)
    words = (
        "effectively improves latency",
        "arrive, live: 0.95 to 1",
        'href="../figures/x.png"',
    )
    assert [said for said in words if said not in page] == []
    assert "figures: x" in render_in_full(ledger)


def test_the_page_is_filtered_by_paper_and_verdict(project):
    ledger = compute_ledger(project)
    of_b = chosen_of(ledger, paper="B")
    assert {entry.claim.id[0] for entry in of_b} == {"B"}
    assert len(chosen_of(ledger, verdict="not yet")) == len(ledger)
    assert not chosen_of(ledger, "B", "deviates")
    assert page_html(project, of_b).count('data-paper="B"') == len(of_b)


def test_a_citation_has_value_interval_runs_verdict_log_commit_and_paper():
    whole = Project(root=PACKAGE.parent)
    [entry] = compute_ledger(whole, committed=True, only=["A-CPU-OURS"])
    digest = hashlib.sha256((whole.root / entry.log).read_bytes()).hexdigest()[:16]
    said = citation(whole, entry)
    parts = (entry.value, entry.unit, "number of runs: 4", "better", digest, "commit ", "SFG-ROS")
    assert [part for part in parts if part not in said] == []


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


def mark(file: Path) -> None:
    """Change kept findings, so that they are known again."""
    kept = json.loads(file.read_text())
    kept["findings"]["origin"] = "kept"
    file.write_text(json.dumps(kept))


def replace(file: Path, old: str, new: str) -> None:
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def test_kept_findings_follow_log_claims_and_the_modules_of_the_experiment(project, copy):
    cached = project.runs / "cache" / "naming" / "naming.json"
    first = claim_by(copy)
    assert (first["verdict"], "cores" in first["origin"]) == ("reproduced", True)
    mark(cached)
    for unrelated in ("lab/experiments/gateways.py", "view/bridge.py"):
        with (copy / "sfglab" / unrelated).open("a") as module:
            module.write("\nCHANGED = 1\n")
    assert claim_by(copy)["origin"] == "kept"
    with (copy / "sfglab" / "names" / "__init__.py").open("a") as module:
        module.write("\nCHANGED = 1\n")
    assert "cores" in claim_by(copy)["origin"]
    mark(cached)
    replace(project.claims, "unit: share of names that hold", "unit: share of all names that hold")
    changed = claim_by(copy)
    assert (changed["unit"], changed["origin"]) == (
        "share of all names that hold",
        first["origin"],
    )
    with (copy / "sfglab" / "lab" / "experiments" / "naming.py").open("a") as module:
        module.write("\nexp._claims['A-FQN'] = (lambda run: None, How.EXACT)\n")
    assert claim_by(copy)["verdict"] == "not yet"
    (project.reference_logs / "naming.mcap").write_bytes(b"no log")
    assert claim_by(copy)["verdict"] == "not yet"


def test_a_damaged_file_of_the_cache_is_ignored(project):
    log = project.reference_logs / "naming.mcap"
    shutil.copy(LEDGER.parent / "reference" / "naming.mcap", log)
    file = project.runs / "cache" / "naming" / "naming.json"
    findings = FindingsCache(project).findings_of("naming", log)
    whole = file.read_text()
    for damaged in (whole[:50], "[]", "{}", json.dumps({**json.loads(whole), "findings": {}})):
        file.write_text(damaged)
        assert FindingsCache(project).findings_of("naming", log) == findings
        assert file.read_text() == whole
