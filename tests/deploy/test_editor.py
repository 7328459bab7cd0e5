"""VS Code's files: what is written is complete, and names only what exists."""

import json
import re
import subprocess

import pytest
import yaml
from esslingen import deployed

from sfglab.deploy.bundle import render_bundle
from sfglab.deploy.dockerfile import VENV
from sfglab.deploy.editor import (
    DEBUGGERS,
    FORMATTERS,
    build_command,
    editor_files,
    environment_command,
)
from sfglab.deploy.files import PROGRAM
from sfglab.fleet.fleet_file import RosDistribution

CONTAINER = ".devcontainer/devcontainer.json"
EXTENSIONS, LAUNCH, SETTINGS, TASKS = (
    f".vscode/{name}.json" for name in ("extensions", "launch", "settings", "tasks")
)


def written(**options):
    return editor_files(deployed(**{"ros": RosDistribution.HUMBLE} | options))


def values(name, **options):
    return json.loads(written(**options)[name].text)


def profiles(kind, request="launch", **options):
    found = values(LAUNCH, **options)["configurations"]
    return [p for p in found if (p["type"], p["request"]) == (kind, request)]


@pytest.mark.parametrize("ros", RosDistribution)
def test_what_the_files_name_exists(ros):
    """Services, folders, tasks, inputs and extensions: no schema says that a name is one of another file."""
    container = values(CONTAINER, ros=ros)
    bundle = render_bundle(deployed("workstation", ros=ros))
    projects = [bundle[path.removeprefix("../")].text for path in container["dockerComposeFile"]]
    base, development = map(yaml.safe_load, projects)
    assert {container["service"], *container["runServices"]} <= set(base["services"])
    mounted = [volume.rpartition(":")[2] for volume in development["services"]["agent"]["volumes"]]
    folder = container["workspaceFolder"]
    assert mounted == [folder, f"{folder}/.vscode"]
    hook = container["initializeCommand"][0].removeprefix("${localWorkspaceFolder}/")
    assert bundle[hook].mode == PROGRAM
    launch = values(LAUNCH, ros=ros)
    tasks = {task["label"] for task in values(TASKS, ros=ros)["tasks"]}
    starts = launch["configurations"]
    assert {one["preLaunchTask"] for one in starts if "preLaunchTask" in one} <= tasks
    assert len({one["name"] for one in starts}) == len(starts)
    asked = set(re.findall(r"\$\{input:(\w+)\}", json.dumps(starts)))
    assert {one["id"] for one in launch["inputs"]} == asked
    extensions = values(EXTENSIONS, ros=ros)["recommendations"]
    assert extensions == container["customizations"]["vscode"]["extensions"]
    assert {*DEBUGGERS.values(), *FORMATTERS.values()} <= set(extensions)


@pytest.mark.parametrize("kind", ["debugpy", "lldb"])
@pytest.mark.parametrize("ros", RosDistribution)
def test_cpp_and_python_nodes_are_started_with_whole_command_lines_and_attached_to(kind, ros):
    started = profiles(kind, ros=ros)
    assert all(
        isinstance(p["args"], str) and p["args"].endswith("${input:arguments}") for p in started
    )
    assert len(profiles(kind, "attach", ros=ros)) == 1


def test_without_ros_nothing_of_colcon_is_written_and_its_commands_are_bash(tmp_path):
    files = written(ros=RosDistribution.NONE)
    assert not any("colcon" in file.text or "/opt/ros" in file.text for file in files.values())
    assert "postCreateCommand" not in json.loads(files[CONTAINER].text)
    assert json.loads(files[SETTINGS].text)["python.defaultInterpreterPath"] == f"{VENV}/bin/python"
    for command in (
        build_command(RosDistribution.JAZZY),
        environment_command(RosDistribution.JAZZY),
    ):
        subprocess.run(["bash", "-n", "-c", command], check=True, timeout=10)
    (tmp_path / "setup.bash").write_text("export ROS_DISTRO=jazzy PYTHONPATH=/p SECRET=x\n")
    command = environment_command(RosDistribution.JAZZY).replace("/opt/ros/jazzy", str(tmp_path))
    subprocess.run(["bash", "-c", command], cwd=tmp_path, check=True, timeout=10)
    kept = (tmp_path / "build" / "ros.env").read_text()
    assert "ROS_DISTRO=jazzy\n" in kept
    assert "PYTHONPATH=/p\n" in kept
    assert "SECRET" not in kept


@pytest.mark.parametrize("ros", [RosDistribution.HUMBLE, RosDistribution.JAZZY])
def test_completion_reads_what_the_build_writes(ros):
    settings_of = values(SETTINGS, ros=ros)
    assert settings_of["python.defaultInterpreterPath"] == "/usr/bin/python3"
    assert "--compile-commands-dir=${workspaceFolder}/build" in settings_of["clangd.arguments"]
    assert "CMAKE_EXPORT_COMPILE_COMMANDS=ON" in values(CONTAINER, ros=ros)["postCreateCommand"][-1]
    assert all(
        f"/opt/ros/{ros.value}/" in path for path in settings_of["python.analysis.extraPaths"]
    )
    assert {"[cpp]", "[python]", "[cmake]"} <= set(settings_of)
