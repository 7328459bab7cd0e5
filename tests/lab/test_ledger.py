"""Which log speaks, what becomes of an unreadable one, and what saved figures say of their origin."""

import asyncio
import json
import shutil
from pathlib import Path

import pytest

from sfglab.lab.claims import Verdict
from sfglab.lab.experiments.naming import exp
from sfglab.lab.ledger import compute_ledger, find_log, redraw_figures
from sfglab.lab.paths import Project
from sfglab.lab.runs import COMPLETION, new_log
from sfglab.record import LogWriter

LEDGER = Path(__file__).parents[2] / "data" / "claims.yaml"


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
        log.write_metadata(COMPLETION, {"profile": profile, "changed": [], "explored": False, **other})
    return path


def test_the_log_that_counts_is_the_asked_profile_else_the_newest_that_speaks_else_the_reference(project):
    folder = project.runs / "logs" / "naming"
    assert find_log(project, "naming") is None
    reference = touch(project.reference_logs / "naming.mcap")
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


def test_new_logs_never_meet(project):
    first = touch(new_log(project, "naming", "quick"))
    assert new_log(project, "naming", "quick") != first


def test_figures_and_verdicts_come_from_the_log_alone(project):
    path = new_log(project, "naming", "quick")
    log = asyncio.run(exp.run("quick", path=path)).log
    entries = {e.claim.id: e for e in compute_ledger(project)}
    assert entries["A-FQN"].verdict is Verdict.REPRODUCED
    assert entries["A-FQN"].log == project.relative(log)
    assert entries["A-CPU-SFG"].verdict is Verdict.NOT_YET
    assert redraw_figures(project) == {}, "a run replaces no figure of the repository"
    shutil.copy(log, project.reference_logs / "naming.mcap")
    files = redraw_figures(project)["naming"]
    assert sorted(p.suffix for p in files) == [".json", ".png", ".svg"]
    before = [p.read_bytes() for p in files]
    assert [p.read_bytes() for p in redraw_figures(project)["naming"]] == before, "deterministic"
    twin = json.loads(next(p for p in files if p.suffix == ".json").read_text())
    assert {"experiment", "config", "log", "log_sha256", "run", "shown"} <= set(twin)


def test_an_unreadable_log_costs_its_own_claims_only_and_is_named(project, caplog):
    asyncio.run(exp.run("quick", path=new_log(project, "naming", "quick")))
    broken = touch(project.reference_logs / "decode_once.mcap")
    broken.write_bytes(b"no log")
    entries = {e.claim.id: e for e in compute_ledger(project)}
    assert entries["A-FQN"].verdict is Verdict.REPRODUCED
    assert entries["A-CPU-SFG"].verdict is Verdict.NOT_YET
    assert broken.name in caplog.text
