"""The part of the lock file that robots get: all that they import, nothing that they do not, digests kept."""

import subprocess
import sys
import textwrap

import pytest
from esslingen import LOCK
from packaging.requirements import Requirement

from sfglab.deploy.errors import DeployError
from sfglab.deploy.release import AGENT_ROOTS, agent_lock, split_lock
from sfglab.fleet.fleet_file import Architecture

PYTHONS = ("3.11", "3.12")
HEAVY = {"cvxpy", "distributed", "jupyterlab", "matplotlib", "pandas", "pyside6", "rerun-sdk", "scikit-image"}

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
    return subprocess.run([sys.executable, "-c", program, allowed], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("arguments", [("agent", "up", "--help"), ("router", "--help"), ("fleet", "--help")])
def test_the_command_line_needs_nothing_else(arguments):
    done = robot(f"""
        sys.argv = ["sfglab", *{arguments!r}]
        runpy.run_module("sfglab", run_name="__main__")
    """)
    assert done.returncode == 0, done.stderr
    assert "Usage" in done.stdout


def test_the_components_of_an_agent_need_nothing_else():
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
    """)
    assert done.returncode == 0, done.stderr


def test_what_is_not_in_the_lock_is_refused_by_the_two_tests_above():
    done = robot("import pandas")
    assert "not in a robot's lock: pandas" in done.stderr


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("architecture", list(Architecture))
def test_everything_is_pinned_once_with_digests_and_without_markers(python, architecture):
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


def test_the_target_chooses_among_versions_and_what_is_not_pinned_is_named():
    old, new = (agent_lock(LOCK, python=python, architecture=Architecture.AMD64) for python in PYTHONS)
    pinned = [next(line for line in lock.splitlines() if line.startswith("numpy==")) for lock in (old, new)]
    assert pinned[0] != pinned[1]
    assert all(line.removesuffix(" \\") in LOCK for line in pinned)
    without, taken = split_lock(LOCK, ("uvloop", "av"))
    assert sorted((without + taken).splitlines()) == sorted(LOCK.splitlines())
    assert set(names(taken)) == {"av", "uvloop"}
    without, _ = split_lock(LOCK, ("uvloop",))
    with pytest.raises(DeployError, match=r"given nothing for Python 3\.11 on arm64 of: uvloop; allowed"):
        agent_lock(without, python="3.11", architecture=Architecture.ARM64)
