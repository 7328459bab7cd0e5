"""Wheels that are the same twice, releases that say where they come from, the lock that robots get."""

import hashlib
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from esslingen import LOCK, PROJECT
from packaging.requirements import Requirement
from waiting import lives, wait_until

from sfglab.deploy.errors import DeployError
from sfglab.deploy.programs import run_streamed
from sfglab.deploy.release import AGENT_ROOTS, agent_lock, build_wheel, make_release, split_lock
from sfglab.fleet.fleet_file import Architecture

MEMBERS = ("pyproject.toml", "README.md", "LICENSE", "install/requirements.lock")


def small_project(folder: Path) -> Path:
    """Return a copy of the project with next to no code in it."""
    for member in (*MEMBERS, "sfglab/__init__.py"):
        (folder / member).parent.mkdir(exist_ok=True)
        shutil.copy(PROJECT / member, folder / member)
    return folder


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    command = ["git", *identity, "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_two_builds_of_the_same_project_are_equal_byte_by_byte(tmp_path):
    project = small_project(tmp_path)
    one = build_wheel(project, tmp_path / "one")
    os.utime(project / "sfglab" / "__init__.py")
    two = build_wheel(project, tmp_path / "two")
    assert one.name == two.name
    assert one.read_bytes() == two.read_bytes()


def test_what_is_no_project_is_refused(monkeypatch, tmp_path):
    with pytest.raises(DeployError, match="wheel: hatchling failed"):
        build_wheel(tmp_path, tmp_path / "wheel")
    with pytest.raises(DeployError, match=r"wheel: .*No such file or directory"):
        build_wheel(tmp_path / "nowhere", tmp_path / "wheel")
    monkeypatch.setattr("sfglab.deploy.release._BUILD_LIMIT_S", 0.01)
    with pytest.raises(DeployError, match=r"wheel: .*timed out"):
        build_wheel(tmp_path, tmp_path / "wheel")
    with pytest.raises(DeployError, match=r"requirements\.lock: this file is missing"):
        make_release(tmp_path, "")


@pytest.mark.skipif(shutil.which("git") is None, reason="git not installed (apt install git)")
def test_a_release_names_its_commit_and_whether_anything_was_changed_since(tmp_path):
    project = small_project(tmp_path)
    git(project, "init", "--quiet")
    git(project, "add", ".")
    git(project, "commit", "--quiet", "--message", "All", "--date", "2026-01-02T03:04:05+00:00")
    clean, wheel = make_release(project, "fleet: f\n")
    assert clean.fleet_text == "fleet: f\n"
    (project / "README.md").write_text("changed")
    dirty, other = make_release(project, "")
    assert clean.revision == git(project, "rev-parse", "HEAD")
    assert dirty.revision == f"{clean.revision}-dirty"
    assert clean.created == git(project, "log", "-1", "--format=%cI")
    digests = [hashlib.sha256(data).hexdigest() for data in (wheel, other)]
    assert digests == [clean.wheel_sha256, dirty.wheel_sha256]
    assert digests[0] != digests[1]


def test_a_program_that_does_not_start_is_an_error():
    with pytest.raises(DeployError, match="does not start"):
        run_streamed(["/nowhere/at/all"], print)


@pytest.mark.parametrize("reason", [KeyboardInterrupt, ValueError])
def test_an_interrupted_build_ends_with_its_children(tmp_path, reason):
    file = tmp_path / "child"

    def interrupt(line: str) -> None:
        raise reason

    with pytest.raises(reason):
        run_streamed(["sh", "-c", f"sleep 60 & echo $! > {file}; echo started; wait"], interrupt)
    wait_until(lambda: not lives(int(file.read_text())))


PYTHONS = ("3.11", "3.12")
HEAVY = {
    "cvxpy",
    "distributed",
    "jupyterlab",
    "matplotlib",
    "pandas",
    "pyside6",
    "rerun-sdk",
    "scikit-image",
}

REFUSE_OTHERS = """
    import importlib.metadata, re, runpy, sys

    allowed = set(sys.argv[1].split(","))
    packages = importlib.metadata.packages_distributions()
    normal = lambda name: re.sub("[-_.]+", "-", name).lower()

    class Refuse:
        def find_spec(self, name, path=None, target=None):
            owners = {normal(owner) for owner in packages.get(name.partition(".")[0], ())} - {"sfglab"}
            if owners and not owners & allowed:
                raise ModuleNotFoundError(f"not in a robot's lock: {name}", name=name)

    sys.meta_path.insert(0, Refuse())
"""


def names(lock: str) -> list[str]:
    return [line.split("==")[0] for line in lock.splitlines() if not line.startswith(" ")]


def robot(script: str) -> subprocess.CompletedProcess[str]:
    """Run a script in a Python that imports nothing but what a robot's lock has."""
    allowed = ",".join(names(agent_lock(LOCK, python="3.11", architecture=Architecture.AMD64)))
    program = textwrap.dedent(REFUSE_OTHERS) + textwrap.dedent(script)
    return subprocess.run(
        [sys.executable, "-c", program, allowed], capture_output=True, text=True, check=False
    )


def test_the_components_of_an_agent_and_its_command_need_nothing_else():
    done = robot("""
        import importlib, pkgutil
        import sfglab.bus, sfglab.codecs, sfglab.deploy, sfglab.fleet, sfglab.messages, sfglab.record

        kept = (sfglab.bus, sfglab.codecs, sfglab.fleet, sfglab.messages, sfglab.record)
        for package in kept:
            for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
                if module.name != "sfglab.bus.ros.program":  # runs in ROS 2's interpreter only
                    importlib.import_module(module.name)
        for name in ("av", "cv2", "cyclonedds", "jinja2", "mcap", "numba", "numpy", "packaging", "psutil",
                     "yaml", "rosbags", "scipy", "tqdm", "typer", "uvloop", "zstandard"):
            importlib.import_module(name)
        sys.argv = ["sfglab", "agent", "up", "--help"]
        runpy.run_module("sfglab", run_name="__main__")
    """)
    assert done.returncode == 0, done.stderr
    assert "Usage" in done.stdout


def test_what_is_not_in_the_lock_is_refused_by_the_test_above():
    assert "not in a robot's lock: pandas" in robot("import pandas").stderr


@pytest.mark.parametrize(("python", "architecture"), [*zip(PYTHONS, Architecture, strict=True)])
def test_everything_is_pinned_once_for_the_target_with_digests_and_without_markers(
    python, architecture
):
    lock = agent_lock(LOCK, python=python, architecture=architecture)
    assert names(lock) == sorted(set(names(lock)))
    assert set(AGENT_ROOTS) <= set(names(lock))
    assert not HEAVY & set(names(lock))
    for entry in lock.replace("\\\n", " ").splitlines():
        head, *digests = entry.split(" --hash=")
        requirement = Requirement(head.strip())
        assert requirement.marker is None
        assert str(requirement.specifier).startswith("==")
        assert digests
        assert all(digest.strip() in LOCK for digest in digests)


def test_a_lock_is_split_by_names_and_what_is_not_pinned_is_named():
    without, taken = split_lock(LOCK, ("uvloop", "av"))
    assert sorted((without + taken).splitlines()) == sorted(LOCK.splitlines())
    assert set(names(taken)) == {"av", "uvloop"}
    without, _ = split_lock(LOCK, ("uvloop",))
    with pytest.raises(
        DeployError, match=r"given nothing for Python 3\.11 on arm64 of: uvloop; allowed"
    ):
        agent_lock(without, python="3.11", architecture=Architecture.ARM64)


def test_what_an_agent_imports_is_installed_where_its_lock_is_made(monkeypatch):
    monkeypatch.setattr("sfglab.deploy.release.AGENT_ROOTS", ("no-such-package",))
    with pytest.raises(DeployError, match="no-such-package: this package is not installed"):
        agent_lock(f"{LOCK}\n", python="3.11", architecture=Architecture.ARM64)
