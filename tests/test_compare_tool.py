"""The comparison of two versions sees planted faults, each in a copy of the package."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FAULTS = {
    "the policy lets everything cross": (
        "fleet/policy.py",
        "return self.deciding(dds_name, direction) is not None",
        "return True",
        "rows/routing.policy.csv",
    ),
    "the cache's equality is inverted": (
        "arp/cache.py",
        "    return bool(first == second)\n",
        "    return not bool(first == second)\n",
        "rules/cache",
    ),
    "Eq. 2 is doubled": (
        "lab/experiments/decode_once/results.py",
        "return count, count, 0.0",
        "return 2 * count, 2 * count, 0.0",
        "rules/cost standard 1 0",
    ),
    "LOST is never announced": (
        "fleet/discovery/lifecycle.py",
        "    ACTIVE            SILENT         LOST              LOST\n",
        "    ACTIVE            SILENT         LOST\n",
        "rules/discovery",
    ),
}
SECTIONS = ("rows:routing", "rules")


@pytest.fixture
def copy(tmp_path):
    """A copy of the package with its data."""
    for name in ("sfglab", "data", "tests"):
        hidden = shutil.ignore_patterns("__pycache__", "reference")
        shutil.copytree(ROOT / name, tmp_path / name, ignore=hidden)
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "data" / "reference").mkdir()
    return tmp_path


def compare(old):
    words = [part for section in SECTIONS for part in ("--only", section)]
    argv = [sys.executable, str(ROOT / "tools" / "compare.py"), str(old), *words]
    argv += ["--baseline", "compare_current.py"]
    return subprocess.run(argv, env=os.environ, capture_output=True, text=True, check=False)


def test_a_copy_without_a_fault_is_equal(copy):
    done = compare(copy)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith(" files compared, 0 differences without a reason\n")


@pytest.mark.slow
def test_each_planted_fault_is_seen(copy):
    for file, right, wrong, _ in FAULTS.values():
        path = copy / "sfglab" / file
        text = path.read_text("utf-8")
        assert text.count(right) == 1, file
        path.write_text(text.replace(right, wrong), "utf-8")
    done = compare(copy)
    assert done.returncode == 1, done.stderr
    for fault, (*_, seen) in FAULTS.items():
        assert f"\n{seen}" in f"\n{done.stdout}", fault
