"""VS Code's files: what is written is complete and consistent, and the checker finds what is not."""

import json
import subprocess

import pytest
import yaml
from esslingen import FLEET, deployed, json_values
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.deploy.dockerfile import VENV
from sfglab.deploy.editor import build_command, editor_files, environment_command
from sfglab.deploy.editor_check import CONTAINER, EXTENSIONS, LAUNCH, SETTINGS, TASKS, check_editor
from sfglab.deploy.files import PROGRAM, BundleFile
from sfglab.fleet.fleet_file import RosDistribution

AGENTS = [agent.name for agent in FLEET.agents]
FILES = (CONTAINER, EXTENSIONS, LAUNCH, TASKS, SETTINGS)

COMPOSE = {"services": {"agent": {"image": "a:1"}, "router": {"image": "a:1"}}}
MOUNTS = ["${SFGLAB_WORKSPACE:-./workspace}:/workspace", "./.vscode:/workspace/.vscode"]
AROUND = {
    "compose.yaml": BundleFile(text=yaml.safe_dump(COMPOSE)),
    "compose.dev.yaml": BundleFile(
        text=yaml.safe_dump({"services": {"agent": {"volumes": MOUNTS}}})
    ),
    "hooks/initialize.sh": BundleFile(text="#!/bin/sh\n", mode=PROGRAM),
}


def written(**options):
    return editor_files(deployed(**{"ros": RosDistribution.HUMBLE} | options))


def values(name, **options):
    return json.loads(written(**options)[name].text)


def profiles(kind, request="launch", **options):
    found = values(LAUNCH, **options)["configurations"]
    return [p for p in found if (p["type"], p["request"]) == (kind, request)]


def says(files):
    return " | ".join(
        f"{finding.place}: {finding.what}" for finding in check_editor(AROUND | files)
    )


@pytest.mark.parametrize("ros", RosDistribution)
@pytest.mark.parametrize("agent", AGENTS)
def test_what_is_written_passes_the_checker(agent, ros):
    assert says(written(agent=agent, ros=ros)) == ""


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


def changed(name, change):
    value = values(name)
    change(value)
    return {**written(), name: BundleFile(text=json.dumps(value))}


def at(*path, to):
    """A change of the value at a path; None takes it away."""

    def change(value):
        for key in path[:-1]:
            value = value[key]
        if to is None:
            value.pop(path[-1], None)
        else:
            value[path[-1]] = to

    return change


FIRST, CPP = ("configurations", 0), ("configurations", 4)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        (CONTAINER, at("servce", to="agent"), "did you mean 'service'"),
        (CONTAINER, at("service", to=None), "service"),
        (CONTAINER, at("service", to="agnet"), "given 'agnet', allowed: agent, router"),
        (CONTAINER, at("runServices", to=["agent", "database"]), "'database'"),
        (
            CONTAINER,
            at("dockerComposeFile", to=["../compose.yml"]),
            "there is no file ../compose.yml",
        ),
        (CONTAINER, at("dockerComposeFile", to="compose.yaml"), "there is no file compose.yaml"),
        (CONTAINER, at("workspaceFolder", to="/work"), "nothing is mounted at /work"),
        (CONTAINER, at("shutdownAction", to="stopContainer"), "allowed: none, stopCompose"),
        (CONTAINER, at("remoteUser", to="root"), "given root"),
        (CONTAINER, at("privileged", to=True), "allowed: false"),
        (
            CONTAINER,
            at("initializeCommand", to=["${localWorkspaceFolder}/init.sh"]),
            "no file init.sh",
        ),
        (CONTAINER, at("initializeCommand", to="hooks/initialize.sh"), "a list of words"),
        (
            CONTAINER,
            at("initializeCommand", to=["${localFolder}/hooks/initialize.sh"]),
            "${localFolder}",
        ),
        (CONTAINER, at("customizations", "vscode", "extension", to=[]), "unknown key 'extension'"),
        (CONTAINER, at("customizations", "vscode", "extensions", to=["clangd"]), "publisher.name"),
        (EXTENSIONS, at("recommendations", to=["a.b", "a.b"]), "twice"),
        (EXTENSIONS, at("recommendations", to=["a.b"]), "needs the extension vadimcn.vscode-lldb"),
        (SETTINGS, at("[cmake]", "editor.defaultFormatter", to="x.y"), "needs the extension x.y"),
        (LAUNCH, at("version", to="0.1.0"), "allowed: '0.2.0'"),
        (LAUNCH, at(*FIRST, "type", to="python"), "given 'python launch'"),
        (LAUNCH, at(*FIRST, "request", to="start"), "debugpy launch"),
        (LAUNCH, at(*FIRST, "porgram", to="x"), "did you mean 'program'"),
        (LAUNCH, at(*FIRST, "program", to=None), "program or module"),
        (LAUNCH, at(*FIRST, "pid", to="1"), "unknown key 'pid'"),
        (LAUNCH, at(*FIRST, "args", to=["${input:arguments}"]), "an input stands in a list"),
        (LAUNCH, at(*FIRST, "console", to="internalConsole"), "allowed: integratedTerminal"),
        (LAUNCH, at(*FIRST, "cwd", to="${workspaceRoot}"), "${workspaceRoot}"),
        (LAUNCH, at(*CPP, "args", to="${input:args}"), "given ${input:args}"),
        (LAUNCH, at(*CPP, "program", to="${command:pick}"), "${command:pick}"),
        (LAUNCH, at(*CPP, "preLaunchTask", to="colcon biuld"), "did you mean 'colcon build'"),
        (LAUNCH, at(*CPP, "name", to="Python node: module"), "twice"),
        (LAUNCH, at("inputs", 0, "type", to="prompt"), "promptString"),
        (LAUNCH, at("inputs", 0, "id", to="x"), "${input:arguments}"),
        (LAUNCH, at("configurations", to={}), "a list of objects"),
        (LAUNCH, at(*FIRST, to="x"), "an entry is no object"),
        (TASKS, at("version", to="0.1.0"), "allowed: '2.0.0'"),
        (TASKS, at("tasks", 0, "label", to="colcon test"), "twice"),
        (TASKS, at("tasks", 0, "command", to=None), "command"),
        (TASKS, at("tasks", 0, "type", to="bash"), "process, shell"),
        (TASKS, at("tasks", 0, "problemMatcher", to=["gcc"]), "$gcc"),
        (TASKS, at("tasks", 0, "options", to={"cwd": "${folder}"}), "${folder}"),
        (TASKS, at("tasks", 3, "dependsOn", to=["colcon"]), "there is no task 'colcon'"),
        (TASKS, at("tasks", 3, "dependOn", to=[]), "unknown key 'dependOn'"),
    ],
)
def test_every_mistake_is_found_in_clear_words(name, change, words):
    assert words in says(changed(name, change))


@pytest.mark.parametrize("name", FILES)
def test_each_file_must_be_there_as_plain_json(name):
    files = written()
    for text, words in (("{} // a comment", "no JSON"), ("[]", "an object")):
        assert words in says(files | {name: BundleFile(text=text)})
    del files[name]
    assert "no such" in says(files)


@pytest.mark.parametrize(
    ("name", "file", "words"),
    [
        ("hooks/initialize.sh", BundleFile(text=""), "is no program"),
        (
            "compose.dev.yaml",
            BundleFile(text="services: {agent: {volumes: ['./w:/workspace']}}"),
            "/.vscode",
        ),
        ("compose.yaml", BundleFile(text="services: {agent: {}}"), "given 'router'"),
    ],
)
def test_what_the_editor_relies_on_in_other_files_is_asked(name, file, words):
    assert words in says(written() | {name: file})


PLACES = [
    *((name, (key,)) for name in FILES for key in values(name)),
    *((LAUNCH, (*FIRST, key)) for key in ("type", "args", "preLaunchTask", "request", "name")),
    *(
        (TASKS, ("tasks", 0, key))
        for key in ("dependsOn", "problemMatcher", "type", "label", "options")
    ),
    *((LAUNCH, ("inputs", 0, key)) for key in ("type", "id")),
    *((CONTAINER, ("customizations", "vscode", key)) for key in ("extensions", "settings")),
]


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(PLACES), json_values)
def test_no_value_makes_the_checker_stumble(place, value):
    name, path = place
    assert isinstance(says(changed(name, at(*path, to=value))), str)
