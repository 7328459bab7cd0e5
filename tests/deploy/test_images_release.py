"""Wheels that are the same twice, releases that say where they come from, the lock that robots get."""

import hashlib
import os
import shutil
import subprocess
import sys
import textwrap

import pytest
from esslingen import LOCK, PROJECT
from packaging.requirements import Requirement
from waiting import lives, wait_until

from sfglab.deploy.errors import DeployError
from sfglab.deploy.programs import run_streamed
from sfglab.deploy.release import (
    AGENT_ROOTS,
    ZENOH_ROOTS,
    agent_lock,
    build_wheel,
    make_release,
    split_lock,
)
from sfglab.fleet.fleet_file import Architecture

MEMBERS = (
    "pyproject.toml",
    "README.md",
    "LICENSE",
    "install/requirements.lock",
    "sfglab/__init__.py",
)


@pytest.fixture
def project(tmp_path):
    """Return a copy of the project with next to no code in it."""
    folder = tmp_path / "project"
    for member in MEMBERS:
        (folder / member).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PROJECT / member, folder / member)
    return folder


def git(folder, *arguments):
    identity = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    command = ["git", *identity, "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_two_builds_of_the_same_project_are_equal_byte_by_byte(project, tmp_path):
    one = build_wheel(project, tmp_path / "one")
    os.utime(project / "sfglab" / "__init__.py")
    two = build_wheel(project, tmp_path / "two")
    assert one.name == two.name
    assert one.read_bytes() == two.read_bytes()


def test_what_is_no_project_is_refused(monkeypatch, tmp_path):
    with pytest.raises(DeployError, match=r"the wheel cannot be built .*; use a checkout"):
        build_wheel(tmp_path, tmp_path / "wheel")
    with pytest.raises(DeployError, match=r"the wheel cannot be built .*No such file or directory"):
        build_wheel(tmp_path / "nowhere", tmp_path / "wheel")
    monkeypatch.setattr("sfglab.deploy.release._BUILD_LIMIT_S", 0.01)
    with pytest.raises(DeployError, match=r"the wheel cannot be built .*timed out"):
        build_wheel(tmp_path, tmp_path / "wheel")
    with pytest.raises(DeployError, match=r"requirements\.lock: this file is missing"):
        make_release(tmp_path, "")


@pytest.mark.skipif(shutil.which("git") is None, reason="git not installed (apt install git)")
def test_a_release_names_its_commit_and_whether_anything_was_changed_since(project):
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
    for release, data in ((clean, wheel), (dirty, other)):
        assert release.wheel_sha256 == hashlib.sha256(data).hexdigest()
    assert wheel != other


def test_a_program_that_does_not_start_is_an_error():
    with pytest.raises(DeployError, match="cannot be started"):
        run_streamed(["/nowhere/at/all"], print)


@pytest.mark.parametrize("reason", [KeyboardInterrupt, ValueError])
def test_an_interrupted_build_ends_with_its_children(tmp_path, reason):
    file = tmp_path / "child"

    def interrupt(line):
        raise reason

    with pytest.raises(reason):
        run_streamed(["sh", "-c", f"sleep 60 & echo $! > {file}; echo started; wait"], interrupt)
    wait_until(lambda: not lives(int(file.read_text())))


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


def names(lock):
    return [line.split("==")[0] for line in lock.splitlines() if not line.startswith(" ")]


USE_ALL = """
    import importlib, pkgutil
    import sfglab.bus, sfglab.codecs, sfglab.deploy, sfglab.fleet, sfglab.messages, sfglab.record

    try:
        import pandas
    except ModuleNotFoundError as error:
        print(error)
    for package in (sfglab.bus, sfglab.codecs, sfglab.fleet, sfglab.messages, sfglab.record):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            # The first runs in ROS 2's interpreter only, the second for a person who manages a fleet.
            if module.name not in ("sfglab.bus.ros.program", "sfglab.fleet.certificates"):
                importlib.import_module(module.name)
    for name in ("av", "cv2", "cyclonedds", "jinja2", "mcap", "numba", "numpy", "packaging", "psutil",
                 "yaml", "rosbags", "scipy", "tqdm", "typer", "uvloop", "zstandard"):
        importlib.import_module(name)
    sys.argv = ["sfglab", "agent", "up", "--help"]
    runpy.run_module("sfglab", run_name="__main__")
"""


def test_the_components_of_an_agent_and_its_command_need_nothing_but_what_a_robots_lock_has():
    allowed = ",".join(names(agent_lock(LOCK, python="3.11", architecture=Architecture.AMD64)))
    program = textwrap.dedent(REFUSE_OTHERS + USE_ALL)
    command = [sys.executable, "-c", program, allowed]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "not in a robot's lock: pandas" in done.stdout
    assert "Usage" in done.stdout


@pytest.mark.parametrize(
    ("python", "architecture"), [*zip(("3.11", "3.12"), Architecture, strict=True)]
)
def test_everything_is_pinned_once_for_the_target_with_digests_and_without_markers(
    python, architecture
):
    plain = names(agent_lock(LOCK, python=python, architecture=architecture))
    lock = agent_lock(LOCK, python=python, architecture=architecture, zenoh=True)
    pinned = names(lock)
    assert pinned == sorted(set(pinned))
    assert set(AGENT_ROOTS) <= set(plain)
    assert set(pinned) - set(plain) == set(ZENOH_ROOTS)
    assert not HEAVY & set(pinned)
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
    with pytest.raises(DeployError, match=r"for Python 3\.11 on arm64 of av, uvloop; run"):
        agent_lock(without, python="3.11", architecture=Architecture.ARM64)


def test_what_an_agent_imports_is_installed_where_its_lock_is_made(monkeypatch):
    monkeypatch.setattr("sfglab.deploy.release.AGENT_ROOTS", ("no-such-package",))
    with pytest.raises(DeployError, match="no-such-package: this package is not installed"):
        agent_lock(f"{LOCK}\n", python="3.11", architecture=Architecture.ARM64)
    monkeypatch.undo()
    monkeypatch.setattr("sfglab.deploy.release.ZENOH_ROOTS", ("no-such-zenoh",))
    with pytest.raises(
        DeployError, match=r"no-such-zenoh: .*; install sfglab with the extra zenoh"
    ):
        agent_lock(f"{LOCK}\n", python="3.11", architecture=Architecture.ARM64, zenoh=True)
