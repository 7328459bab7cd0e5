"""Both distributions as their users have them: built, unpacked alone, and used; and what a robot's takes."""

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from sfglab.deploy.release import AGENT_ROOTS, SOURCE, agent_lock, build_wheel
from sfglab.fleet.fleet_file import Architecture

ROBOT = tomllib.loads((SOURCE / "robot/pyproject.toml").read_text())["project"]
OURS = tomllib.loads((SOURCE / "pyproject.toml").read_text())["project"]
FLEET = SOURCE / "data/fleets/esslingen.yaml"
MOST_BYTES = 400e6
BLOCKED = "import sys; sys.modules.update(dict.fromkeys(('numba', 'llvmlite', 'cv2', 'pandas', 'IPython')));"


@pytest.fixture(scope="module", params=["", "robot"])
def installed(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    wheel = build_wheel(SOURCE / request.param, folder)
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return wheel, folder / "site"


def run(site, code, *words, status=0):
    environment = os.environ | {"PYTHONPATH": str(site)}
    environment.pop("SFGLAB_ROOT", None)
    code = f"import sfglab; assert sfglab.__file__.startswith({str(site)!r}); {code}"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *words],
        cwd=site.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stderr
    return done.stdout


def test_an_installed_wheel_renders_a_fleet_with_the_wheel_that_it_came_from(installed, tmp_path):
    wheel, site = installed
    if "robot" in wheel.name:
        pytest.skip("a robot gets its release, and makes none")
    code = "from sfglab.cli import main; main()"
    said = run(
        site, code, "deploy", "render", str(FLEET), "-o", str(tmp_path), "--accelerator", "none"
    )
    folders = re.findall(r"^(.*): \d+ files, release", said, re.MULTILINE)
    assert folders
    for folder in folders:
        (made,) = Path(folder, "image").glob("*.whl")
        assert made.read_bytes() == wheel.read_bytes()


def test_what_a_robot_runs_is_imported_from_its_wheel_without_what_it_lacks(installed):
    _, site = installed
    names = "fleet.agent.app fleet.decoder.node fleet.router.node fleet.discovery fleet.status record codecs"
    loop = f"[importlib.import_module('sfglab.' + name) for name in {names.split()!r}]"
    run(site, f"{BLOCKED} import importlib; {loop}")
    run(site, f"{BLOCKED} from sfglab.cli import main; main()", "fleet", "lint", str(FLEET))


def test_a_robot_gets_what_an_agents_image_gets_and_what_we_say():
    of = {Requirement(text).name: text for text in OURS["dependencies"]}
    depth = ROBOT["optional-dependencies"]["depth"]
    assert sorted([*ROBOT["dependencies"], *depth]) == sorted(of[name] for name in AGENT_ROOTS)
    assert {Requirement(text).name for text in depth} == {"numba", "opencv-python-headless"}
    assert (ROBOT["requires-python"], ROBOT["scripts"]) == (
        OURS["requires-python"],
        OURS["scripts"],
    )


def test_a_robots_distribution_takes_less_than_400_mb(installed):
    _, site = installed
    text = (SOURCE / "requirements.lock").read_text()
    lock = agent_lock(text, python="3.11", architecture=Architecture.AMD64)
    large = {"numba", "llvmlite", "opencv-python-headless"}
    names = set(re.findall(r"^([a-z0-9-]+)", lock, re.MULTILINE)) - large
    files = [
        file.locate()
        for name in names
        for file in distribution(name).files
        if file.suffix != ".pyc"
    ]
    files += site.rglob("*")
    assert (
        50e6 < sum(Path(file).stat().st_size for file in files if Path(file).is_file()) < MOST_BYTES
    )
