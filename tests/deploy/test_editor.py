"""VS Code's files: what is written is complete, and names only what exists."""

import json
import re
import subprocess

import pytest
import yaml
from esslingen import deployed

from sfglab.deploy.bundle import render_bundle
from sfglab.deploy.dockerfile import VENV
from sfglab.deploy.editor import build_command, environment_command
from sfglab.deploy.files import PROGRAM
from sfglab.fleet.fleet_file import RosDistribution

CONTAINER = ".devcontainer/devcontainer.json"


def written(ros):
    """Return the workstation's files in a fleet with a ROS 2 distribution, and the values of VS Code's."""
    bundle = render_bundle(deployed("workstation", ros=ros))
    paths = [path for path in bundle if path.startswith((".vscode", ".devcontainer"))]
    return bundle, {path: json.loads(bundle[path].text) for path in paths}


@pytest.mark.parametrize("ros", RosDistribution)
def test_what_the_files_name_exists(ros):
    """Services, folders, tasks, inputs and extensions: no schema says that a name is one of another file."""
    bundle, values = written(ros)
    container, launch = values[CONTAINER], values[".vscode/launch.json"]
    projects = [bundle[path.removeprefix("../")].text for path in container["dockerComposeFile"]]
    base, development = map(yaml.safe_load, projects)
    assert {container["service"], *container["runServices"]} <= set(base["services"])
    mounted = [volume.rpartition(":")[2] for volume in development["services"]["agent"]["volumes"]]
    folder = container["workspaceFolder"]
    assert mounted == [folder, f"{folder}/.vscode"]
    hook = container["initializeCommand"][0].removeprefix("${localWorkspaceFolder}/")
    assert bundle[hook].mode == PROGRAM
    tasks = {task["label"] for task in values[".vscode/tasks.json"]["tasks"]}
    starts = launch["configurations"]
    assert {one["preLaunchTask"] for one in starts if "preLaunchTask" in one} <= tasks
    assert len({one["name"] for one in starts}) == len(starts)
    asked = set(re.findall(r"\$\{input:(\w+)\}", json.dumps(starts)))
    assert {one["id"] for one in launch["inputs"]} == asked
    extensions = values[".vscode/extensions.json"]["recommendations"]
    assert extensions == container["customizations"]["vscode"]["extensions"]


def test_without_ros_nothing_of_colcon_is_written():
    _, values = written(RosDistribution.NONE)
    assert not re.search("colcon|/opt/ros", str(values))
    assert "postCreateCommand" not in values[CONTAINER]
    assert values[".vscode/settings.json"]["python.defaultInterpreterPath"] == f"{VENV}/bin/python"


def test_the_commands_are_bash_and_debuggers_get_the_environment_of_ros_alone(tmp_path):
    build = build_command(RosDistribution.JAZZY)
    subprocess.run(["bash", "-n", "-c", build], check=True, timeout=10)
    (tmp_path / "setup.bash").write_text("export ROS_DISTRO=jazzy PYTHONPATH=/p SECRET=x\n")
    command = environment_command(RosDistribution.JAZZY).replace("/opt/ros/jazzy", str(tmp_path))
    subprocess.run(["bash", "-c", command], cwd=tmp_path, check=True, timeout=10)
    kept = (tmp_path / "build" / "ros.env").read_text().splitlines()
    assert {"ROS_DISTRO=jazzy", "PYTHONPATH=/p"} <= set(kept)
    assert "SECRET=x" not in kept
