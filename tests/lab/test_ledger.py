"""Which log speaks, what becomes of an unreadable one, and what saved figures say of their origin."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from sfglab.lab.claims import Verdict
from sfglab.lab.experiments import naming
from sfglab.lab.ledger import compute_ledger, find_log, new_log, redraw_figures
from sfglab.lab.paths import Project

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


def test_the_log_that_counts_is_the_asked_profile_else_a_real_run_else_the_reference(project):
    folder = project.runs / "logs" / "naming"
    assert find_log(project, "naming") is None
    smoke = touch(folder / "20260101T000003-smoke.mcap")
    assert find_log(project, "naming") == smoke
    reference = touch(project.reference_logs / "naming.mcap")
    assert find_log(project, "naming") == reference
    old, new = (touch(folder / f"2026010{day}T000000-quick.mcap") for day in (1, 2))
    assert find_log(project, "naming") == new != old
    assert find_log(project, "naming", profile="smoke") == smoke


def test_new_logs_never_meet(project):
    first = touch(new_log(project, "naming", "quick"))
    assert new_log(project, "naming", "quick") != first


def test_figures_and_verdicts_come_from_the_log_alone(project):
    log = naming.run(naming.Config.of_profile("smoke"), new_log(project, "naming", "smoke"))
    entries = {e.claim.id: e for e in compute_ledger(project)}
    assert entries["A-FQN"].verdict is Verdict.REPRODUCED
    assert entries["A-FQN"].log == project.relative(log)
    assert entries["A-CPU-SFG"].verdict is Verdict.NOT_YET
    files = redraw_figures(project)["naming"]
    assert sorted(p.suffix for p in files) == [".json", ".png", ".svg"]
    before = [p.read_bytes() for p in files]
    assert [p.read_bytes() for p in redraw_figures(project)["naming"]] == before, "deterministic"
    twin = json.loads(next(p for p in files if p.suffix == ".json").read_text())
    assert {"experiment", "config", "log", "log_sha256", "run", "shown"} <= set(twin)


def test_an_unreadable_log_costs_its_own_claims_only_and_is_named(project, caplog):
    naming.run(naming.Config.of_profile("smoke"), new_log(project, "naming", "quick"))
    broken = new_log(project, "decode_once", "quick")
    touch(broken).write_bytes(b"no log")
    entries = {e.claim.id: e for e in compute_ledger(project)}
    assert entries["A-FQN"].verdict is Verdict.REPRODUCED
    assert entries["A-CPU-SFG"].verdict is Verdict.NOT_YET
    assert broken.name in caplog.text
