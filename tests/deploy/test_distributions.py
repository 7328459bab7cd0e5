"""Both distributions as their users have them: built, unpacked alone, and used; and what a robot's takes."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import distribution

import pytest
from packaging.requirements import Requirement

from sfglab.deploy.release import AGENT_ROOTS, SOURCE, ZENOH_ROOTS, agent_lock, build_wheel
from sfglab.fleet.fleet_file import Architecture

ROBOT = tomllib.loads((SOURCE / "install/robot/pyproject.toml").read_text())["project"]
OURS = tomllib.loads((SOURCE / "pyproject.toml").read_text())["project"]
FLEET = SOURCE / "data/fleets/esslingen.yaml"
MOST_BYTES = 400e6
BLOCKED = "import sys; sys.modules.update(dict.fromkeys(('numba', 'llvmlite', 'cv2', 'pandas', 'IPython')));"


def unpacked(folder, tmp_path_factory):
    """Return a wheel, and the folder in which it is installed alone."""
    place = tmp_path_factory.mktemp("wheel")
    wheel = build_wheel(SOURCE / folder, place)
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(place / "site")
    return wheel, place / "site"


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return unpacked("install/robot", tmp_path_factory)[1]


def run(site, code, *words):
    environment = os.environ | {"PYTHONPATH": str(site), "SFGLAB_ROOT": ""}
    code = f"import sfglab; assert sfglab.__file__.startswith({str(site)!r}); {code}"
    command = [sys.executable, "-P", "-c", code, *words]
    subprocess.run(command, cwd=site.parent, env=environment, check=True)


def test_an_installed_wheel_renders_a_fleet_with_the_wheel_that_it_came_from(tmp_path_factory):
    wheel, site = unpacked("", tmp_path_factory)
    code = "from sfglab.cli import main; main()"
    folder = tmp_path_factory.mktemp("rendered")
    words = ("-o", str(folder), "--agent", "pi1", "--accelerator", "none")
    run(site, code, "deploy", "render", str(FLEET), *words)
    (made,) = folder.glob("pi1/image/*.whl")
    assert made.read_bytes() == wheel.read_bytes()


def test_what_a_robot_runs_is_imported_from_its_wheel_without_what_it_lacks(robot):
    names = "fleet.agent.app fleet.decoder.node fleet.router.node fleet.discovery fleet.status record codecs"
    loop = f"[importlib.import_module('sfglab.' + name) for name in {names.split()!r}]"
    run(robot, f"{BLOCKED} import importlib; {loop}")


def test_a_robot_gets_what_an_agents_image_gets_and_what_we_say():
    of = {Requirement(text).name: text for text in OURS["dependencies"]}
    depth = ROBOT["optional-dependencies"]["depth"]
    zenoh = ROBOT["optional-dependencies"]["zenoh"]
    assert {Requirement(text).name for text in zenoh} == set(ZENOH_ROOTS)
    assert sorted([*ROBOT["dependencies"], *depth]) == sorted(of[name] for name in AGENT_ROOTS)
    assert {Requirement(text).name for text in depth} == {"numba", "opencv-python-headless"}
    assert (ROBOT["requires-python"], ROBOT["scripts"]) == (
        OURS["requires-python"],
        OURS["scripts"],
    )


def test_a_robots_distribution_takes_less_than_400_mb(robot):
    text = (SOURCE / "install/requirements.lock").read_text()
    lock = agent_lock(text, python="3.11", architecture=Architecture.AMD64)
    large = {"numba", "llvmlite", "opencv-python-headless"}
    size = sum(file.stat().st_size for file in robot.rglob("*"))
    for name in set(re.findall(r"^([a-z0-9-]+)", lock, re.MULTILINE)) - large:
        files = [file.locate() for file in distribution(name).files if file.suffix != ".pyc"]
        size += sum(file.stat().st_size for file in files if file.is_file())
    assert 50e6 < size < MOST_BYTES
