"""The tool that makes committed logs: it refuses what is no evidence, and touches nothing then."""

import asyncio
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from sfglab.lab.experiments import experiment
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[1]
TOOL = ROOT / "tools" / "reference.py"


@pytest.fixture
def project(tmp_path):
    """A repository with claims and notebooks, and one commit."""
    (tmp_path / "data").mkdir()
    shutil.copy(ROOT / "data" / "claims.yaml", tmp_path / "data")
    (tmp_path / "notebooks").mkdir()
    shutil.copy(ROOT / "notebooks" / "11_names_and_border.ipynb", tmp_path / "notebooks")
    (tmp_path / ".gitignore").write_text("runs/\n")
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "x"]):
        who = ["-c", "user.name=x", "-c", "user.email=x"]
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True)
    return Project(root=tmp_path)


def tool(project, *words):
    environment = os.environ | {"SFGLAB_ROOT": str(project.root), "PYTHONPATH": str(ROOT)}
    argv = [sys.executable, str(TOOL), *words]
    return subprocess.run(argv, env=environment, capture_output=True, text=True, check=False)


def logged(project, profile, **changes):
    """Return the log of a run below runs/, as a user makes it."""
    path = project.runs / "logs" / "naming" / f"20260101T000000-{profile}.mcap"
    return asyncio.run(experiment("naming").run(profile, path=path, **changes)).log


@pytest.mark.slow
def test_a_run_becomes_the_committed_log_with_its_figures(project):
    done = tool(project, "naming", "--dirty")
    assert done.returncode == 0, done.stderr
    assert "naming: commit, then --notebooks 11_names_and_border 01_ledger" in done.stdout
    first = (project.reference_logs / "naming.mcap").read_bytes()
    assert {path.suffix for path in project.figures.iterdir()} == {".svg", ".png", ".json"}
    log = logged(project, "quick", seed=1)
    done = tool(project, "naming", "--dirty", "--keep-previous", "--from", str(log))
    assert done.returncode == 0, done.stderr
    assert (project.reference_logs / "naming.mcap").read_bytes() == log.read_bytes() != first
    assert (project.reference_logs / "again" / "naming_1.json").is_file()


def test_a_tree_with_changes_is_refused_before_anything_runs(project):
    (project.root / "new.txt").write_text("x")
    done = tool(project, "naming")
    assert (done.returncode, done.stdout) == (2, "")
    assert "reference: the working tree has 1 changed files; commit them, or give" in done.stderr
    assert not project.reference_logs.exists()


@pytest.mark.parametrize(
    ("profile", "changes", "why"),
    [
        ("smoke", {}, "it is a smoke test"),
        ("quick", {"samples": 10}, "changed: samples"),
    ],
)
def test_a_log_that_counts_for_no_claim_is_refused(project, profile, changes, why):
    log = logged(project, profile, **changes)
    done = tool(project, "naming", "--dirty", "--from", str(log))
    assert done.returncode == 2
    assert why in done.stderr
    assert not (project.reference_logs / "naming.mcap").exists()


def test_an_unfinished_log_is_refused(project):
    log = project.runs / "a.mcap"
    log.parent.mkdir()
    log.write_bytes(b"no log")
    done = tool(project, "naming", "--dirty", "--from", str(log))
    assert done.returncode == 2
    assert "a.mcap" in done.stderr
