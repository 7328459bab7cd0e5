"""Files of VS Code for an agent: development container, debugging, building, formatting (paper A, 4.4)."""

from __future__ import annotations

import json
import shlex
from typing import Any

from sfglab.deploy.deployment import FLEET_FILE, USER, Deployment
from sfglab.deploy.files import BundleFile, text_file
from sfglab.fleet.fleet_file import RosDistribution

#: Path of the Python that runs sfglab in the images; ROS 2 nodes use the distribution's own Python.
INTERPRETER = "/opt/venv/bin/python"

#: Environment of the workspace's nodes, for debuggers, which source no shell files.
ENVIRONMENT_FILE = "build/ros.env"

_KEPT = "^(AMENT_|CMAKE_PREFIX_PATH=|COLCON_|LD_LIBRARY_PATH=|PATH=|PYTHONPATH=|ROS_)"


def _sourced(ros: RosDistribution, command: str) -> str:
    """Return a command line for Bash that runs a command in the distribution's environment."""
    return f"source /opt/ros/{ros.value}/setup.bash && {command}"


def build_command(ros: RosDistribution) -> str:
    """Return the command line that builds the workspace, with debug symbols and compile commands for completion."""
    flags = "-DCMAKE_BUILD_TYPE=Debug -DCMAKE_EXPORT_COMPILE_COMMANDS=ON"
    return _sourced(ros, f"colcon build --symlink-install --cmake-args {flags}")


def environment_command(ros: RosDistribution) -> str:
    """Return the command line that writes `ENVIRONMENT_FILE`."""
    overlay = "{ [ ! -f install/setup.bash ] || source install/setup.bash; }"
    return _sourced(
        ros, f"{overlay} && mkdir -p build && printenv | grep -E '{_KEPT}' > {ENVIRONMENT_FILE}"
    )


_CLANGD = "llvm-vs-code-extensions.vscode-clangd"

DEBUGGERS = {"debugpy": "ms-python.debugpy", "lldb": "vadimcn.vscode-lldb"}  #: Extensions.

FORMATTERS = {
    "c": _CLANGD,
    "cpp": _CLANGD,
    "python": "charliermarsh.ruff",
    "cmake": "cheshirekow.cmake-format",
}
"""Extension that formats each language: clangd by clang-format's rules, Ruff, cmake-format."""

_OTHERS = ("ms-python.python", "ms-vscode.cmake-tools", "redhat.vscode-yaml")
EXTENSIONS = tuple(sorted({*_OTHERS, *DEBUGGERS.values(), *FORMATTERS.values()}))
"""All extensions of a workspace. They are the same without ROS 2, because C++ programs do not need it."""

_BUILT = ("build", "install", "log")


#: Python of each distribution's Ubuntu (REP 2000).
_PYTHON = {RosDistribution.HUMBLE: "3.10", RosDistribution.JAZZY: "3.12"}


def _workspace_settings(ros: RosDistribution) -> dict[str, Any]:
    """Return ``settings.json``; without a ROS 2 distribution, it has no settings for ROS 2 and colcon."""
    languages: dict[str, dict[str, Any]] = {
        f"[{name}]": {"editor.defaultFormatter": tool} for name, tool in FORMATTERS.items()
    }
    languages["[python]"] |= {"editor.codeActionsOnSave": {"source.organizeImports": "explicit"}}
    settings = {
        "python.defaultInterpreterPath": INTERPRETER
        if ros is RosDistribution.NONE
        else "/usr/bin/python3",
        "clangd.arguments": [
            "--compile-commands-dir=${workspaceFolder}/build",
            "--header-insertion=never",
        ],
        # The build configures CMake packages; opening a folder does not.
        "cmake.configureOnOpen": False,
        "python.analysis.typeCheckingMode": "basic",
        "editor.formatOnSave": True,
        "files.insertFinalNewline": True,
        **languages,
    }
    if ros is RosDistribution.NONE:
        return settings
    prefix, python = f"/opt/ros/{ros.value}", f"python{_PYTHON[ros]}"
    paths = [f"{prefix}/lib/{python}/site-packages", f"{prefix}/local/lib/{python}/dist-packages"]
    built = dict.fromkeys((f"**/{folder}/**" for folder in _BUILT), True)
    return settings | {
        "python.envFile": f"${{workspaceFolder}}/{ENVIRONMENT_FILE}",
        "python.analysis.extraPaths": paths,
        "files.watcherExclude": built,
        "search.exclude": built,
    }


ENVIRONMENT = "ROS environment"
BUILD = "colcon build"
BUILD_ALL = "colcon build and environment"


def _tasks(ros: RosDistribution) -> dict[str, Any]:
    """Return ``tasks.json``; without a distribution there is no colcon."""
    check = {
        "label": "sfglab deploy check",
        "type": "process",
        "command": "sfglab",
        "args": ["deploy", "check", FLEET_FILE],
        "problemMatcher": [],
    }
    colcon = [] if ros is RosDistribution.NONE else _colcon_tasks(ros)
    return {"version": "2.0.0", "tasks": [*colcon, check]}


def _colcon_tasks(ros: RosDistribution) -> list[dict[str, Any]]:
    test = _sourced(ros, "colcon test && colcon test-result --verbose")
    return [
        _bash(BUILD, build_command(ros), "build"),
        _bash("colcon test", test, "test"),
        _bash(ENVIRONMENT, environment_command(ros)),
        {
            "label": BUILD_ALL,
            "dependsOn": [BUILD, ENVIRONMENT],
            "dependsOrder": "sequence",
            "problemMatcher": [],
        },
    ]


def _bash(label: str, command: str, kind: str = "") -> dict[str, Any]:
    """Return a task that runs a command in Bash; with a `kind`, it is the default task of its kind and a compiler's."""
    task: dict[str, Any] = {
        "label": label,
        "type": "process",
        "command": "bash",
        "args": ["-c", command],
        "options": {"cwd": "${workspaceFolder}"},
        "problemMatcher": ["$gcc"] if kind else [],
    }
    if kind:
        task["group"] = {"kind": kind, "isDefault": True}
    return task


#: Port of ``python -m debugpy --listen 5678 ...``, as in the documentation of debugpy.
DEBUGPY_PORT = 5678

_ARGUMENTS = "${input:arguments}"
_INPUTS = {
    "arguments": "Arguments as in a shell, as in: --ros-args -r __ns:=/go2 -p use_sim_time:=true",
    "executable": "Executable of that package",
    "module": "Python module, as after python -m",
    "package": "ROS package of the C++ node",
    "program": "Path of the C++ program",
}


def _profiles(deployment: Deployment) -> dict[str, Any]:
    """Return ``launch.json``: profiles that start or attach to C++ and Python nodes, and one for the agent itself."""
    ros = deployment.common.ros is not RosDistribution.NONE
    profiles = [*_python(deployment, ros=ros), *_cpp(ros=ros)]
    inputs = []
    for name, text in _INPUTS.items():
        if f"${{input:{name}}}" in str(profiles):
            inputs.append({"id": name, "type": "promptString", "description": text, "default": ""})
    return {"version": "0.2.0", "configurations": profiles, "inputs": inputs}


def _python(deployment: Deployment, *, ros: bool) -> list[dict[str, Any]]:
    start: dict[str, Any] = {
        "type": "debugpy",
        "request": "launch",
        "cwd": "${workspaceFolder}",
        "console": "integratedTerminal",
        "justMyCode": False,
        **(_environment(ENVIRONMENT) if ros else {}),
    }
    return [
        {"name": "Python node: current file", **start, "program": "${file}", "args": _ARGUMENTS},
        {"name": "Python node: module", **start, "module": "${input:module}", "args": _ARGUMENTS},
        {
            "name": "sfglab agent up",
            **start,
            "module": "sfglab",
            "python": INTERPRETER,  # not the distribution's, which is for nodes
            "args": f"{shlex.join(deployment.agent_command)} {_ARGUMENTS}",
            "subProcess": True,
        },
        {
            "name": f"Python node: attach (python -m debugpy --listen {DEBUGPY_PORT} ...)",
            "type": "debugpy",
            "request": "attach",
            "connect": {"host": "127.0.0.1", "port": DEBUGPY_PORT},
            "justMyCode": False,
        },
    ]


def _cpp(*, ros: bool) -> list[dict[str, Any]]:
    installed = (
        "${workspaceFolder}/install/${input:package}/lib/${input:package}/${input:executable}"
    )
    return [
        {
            "name": "C++ node",
            "type": "lldb",
            "request": "launch",
            "program": installed if ros else "${input:program}",
            "args": _ARGUMENTS,
            "cwd": "${workspaceFolder}",
            "terminal": "integrated",
            **(_environment(BUILD_ALL) if ros else {}),
        },
        {
            "name": "C++ node: attach (needs kernel.yama.ptrace_scope=0)",
            "type": "lldb",
            "request": "attach",
            "pid": "${command:pickMyProcess}",
        },
    ]


def _environment(task: str) -> dict[str, Any]:
    return {"envFile": f"${{workspaceFolder}}/{ENVIRONMENT_FILE}", "preLaunchTask": task}


def _container(deployment: Deployment) -> dict[str, Any]:
    """Return ``devcontainer.json``; hooks run before its containers (paper A, 4.4, "Lifecycle Hooks")."""
    ros = deployment.common.ros
    settings: dict[str, Any] = {
        "name": f"{deployment.agent.name} ({deployment.fleet.name})",
        "dockerComposeFile": ["../compose.yaml", "../compose.dev.yaml"],
        "service": "agent",
        "runServices": ["agent", "router"],
        "workspaceFolder": "/workspace",
        "shutdownAction": "stopCompose",
        # A list runs without a shell, so no character of the folder's name has a special meaning.
        "initializeCommand": ["${localWorkspaceFolder}/hooks/initialize.sh", "--development"],
        "remoteUser": USER,
        "customizations": {
            "vscode": {"extensions": list(EXTENSIONS), "settings": _workspace_settings(ros)}
        },
    }
    if ros is not RosDistribution.NONE:
        settings["postCreateCommand"] = ["bash", "-c", build_command(ros)]
    return settings


def editor_files(deployment: Deployment) -> dict[str, BundleFile]:
    """Return an agent's development container and VS Code's settings, plain JSON (paper A, section 4.4)."""
    ros = deployment.common.ros
    values: dict[str, Any] = {
        ".devcontainer/devcontainer.json": _container(deployment),
        ".vscode/extensions.json": {"recommendations": list(EXTENSIONS)},
        ".vscode/launch.json": _profiles(deployment),
        ".vscode/settings.json": _workspace_settings(ros),
        ".vscode/tasks.json": _tasks(ros),
    }
    return {name: text_file(json.dumps(value, indent=2) + "\n") for name, value in values.items()}
