"""An agent's folder in VS Code: development container, debugging, building, formatting (paper A, 4.4)."""

from __future__ import annotations

import json
import shlex
from typing import TYPE_CHECKING, Any

from sfglab.deploy.files import BundleFile
from sfglab.fleet.fleet_file import RosDistribution

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


PYTHON = {RosDistribution.HUMBLE: "3.10", RosDistribution.JAZZY: "3.12"}
"""Python of the Ubuntu that a distribution is made for (REP 2000)."""

INTERPRETER = "/opt/venv/bin/python"
"""Python that has sfglab in the images; nodes of a distribution run on the system's."""

ENVIRONMENT_FILE = "build/ros.env"
"""Where the environment of the workspace's nodes is kept for debuggers, which source no shell files."""

_KEPT = "^(AMENT_|CMAKE_PREFIX_PATH=|COLCON_|LD_LIBRARY_PATH=|PATH=|PYTHONPATH=|ROS_)"


def sourced(ros: RosDistribution, command: str) -> str:
    """Return a command line for Bash that runs a command in the distribution's environment."""
    return f"source /opt/ros/{ros.value}/setup.bash && {command}"


def build_command(ros: RosDistribution) -> str:
    """Return how the workspace is built: with symbols, and with compile commands for code completion.

    colcon collects the compile commands of all packages in ``build/compile_commands.json`` (colcon-cmake).
    """
    flags = "-DCMAKE_BUILD_TYPE=Debug -DCMAKE_EXPORT_COMPILE_COMMANDS=ON"
    return sourced(ros, f"colcon build --symlink-install --cmake-args {flags}")


def environment_command(ros: RosDistribution) -> str:
    """Return how `ENVIRONMENT_FILE` is written."""
    overlay = "{ [ ! -f install/setup.bash ] || source install/setup.bash; }"
    return sourced(ros, f"{overlay} && mkdir -p build && printenv | grep -E '{_KEPT}' > {ENVIRONMENT_FILE}")


_CLANGD = "llvm-vs-code-extensions.vscode-clangd"

DEBUGGERS = {"debugpy": "ms-python.debugpy", "lldb": "vadimcn.vscode-lldb"}
"""Extension that brings each type of debugger."""

FORMATTERS = {"c": _CLANGD, "cpp": _CLANGD, "python": "charliermarsh.ruff", "cmake": "cheshirekow.cmake-format"}
"""Extension that formats each language: clangd by clang-format's rules, Ruff, cmake-format."""

_OTHERS = ("ms-python.python", "ms-vscode.cmake-tools", "redhat.vscode-yaml")
EXTENSIONS = tuple(sorted({*_OTHERS, *DEBUGGERS.values(), *FORMATTERS.values()}))
"""All that a workspace needs: the same without ROS, because nodes in C++ need none."""

_BUILT = ("build", "install", "log")


def workspace_settings(ros: RosDistribution) -> dict[str, Any]:
    """Return ``settings.json``.

    Args:
        ros: The distribution in the images; without one, nothing of it or of colcon is set.
    """
    return _completion(ros) | _formatting() | (_colcon_settings(ros) if ros is not RosDistribution.NONE else {})


def _completion(ros: RosDistribution) -> dict[str, Any]:
    return {
        "python.defaultInterpreterPath": INTERPRETER if ros is RosDistribution.NONE else "/usr/bin/python3",
        "clangd.arguments": ["--compile-commands-dir=${workspaceFolder}/build", "--header-insertion=never"],
        # CMake packages are configured by the build, not by opening a folder.
        "cmake.configureOnOpen": False,
        "python.analysis.typeCheckingMode": "basic",
    }


def _formatting() -> dict[str, Any]:
    languages: dict[str, dict[str, Any]] = {
        f"[{name}]": {"editor.defaultFormatter": tool} for name, tool in FORMATTERS.items()
    }
    languages["[python]"] |= {"editor.codeActionsOnSave": {"source.organizeImports": "explicit"}}
    return {"editor.formatOnSave": True, "files.insertFinalNewline": True, **languages}


def _colcon_settings(ros: RosDistribution) -> dict[str, Any]:
    python = f"python{PYTHON[ros]}"
    prefix = f"/opt/ros/{ros.value}"
    paths = [f"{prefix}/lib/{python}/site-packages", f"{prefix}/local/lib/{python}/dist-packages"]
    built = dict.fromkeys((f"**/{folder}/**" for folder in _BUILT), True)
    return {
        "python.envFile": f"${{workspaceFolder}}/{ENVIRONMENT_FILE}",
        "python.analysis.extraPaths": paths,
        "files.watcherExclude": built,
        "search.exclude": built,
    }


FLEET_FILE = "/etc/sfglab/fleet.yaml"
ENVIRONMENT = "ROS environment"
BUILD = "colcon build"
BUILD_ALL = "colcon build and environment"


def build_tasks(ros: RosDistribution) -> dict[str, Any]:
    """Return ``tasks.json``.

    Args:
        ros: The distribution in the images; without one there is no colcon.
    """
    check = {
        "label": "sfglab deploy check",
        "type": "process",
        "command": "sfglab",
        "args": ["deploy", "check", FLEET_FILE],
        "problemMatcher": [],
    }
    return {"version": "2.0.0", "tasks": [*(() if ros is RosDistribution.NONE else _colcon_tasks(ros)), check]}


def _colcon_tasks(ros: RosDistribution) -> tuple[dict[str, Any], ...]:
    test = sourced(ros, "colcon test && colcon test-result --verbose")
    return (
        _bash(BUILD, build_command(ros), group={"kind": "build", "isDefault": True}, matcher=["$gcc"]),
        _bash("colcon test", test, group={"kind": "test", "isDefault": True}, matcher=["$gcc"]),
        _bash(ENVIRONMENT, environment_command(ros)),
        {
            "label": BUILD_ALL,
            "dependsOn": [BUILD, ENVIRONMENT],
            "dependsOrder": "sequence",
            "problemMatcher": [],
        },
    )


def _bash(
    label: str, command: str, *, group: dict[str, Any] | None = None, matcher: list[str] | None = None
) -> dict[str, Any]:
    task: dict[str, Any] = {
        "label": label,
        "type": "process",
        "command": "bash",
        "args": ["-c", command],
        "options": {"cwd": "${workspaceFolder}"},
        "problemMatcher": matcher or [],
    }
    return task | ({"group": group} if group else {})


DEBUGPY_PORT = 5678
"""Where ``python -m debugpy --listen 5678 ...`` waits; its own documentation's example."""

_ARGUMENTS = "${input:arguments}"
_INPUTS = {
    "arguments": "Arguments as in a shell, as in: --ros-args -r __ns:=/go2 -p use_sim_time:=true",
    "executable": "Executable of that package",
    "module": "Python module, as after python -m",
    "package": "ROS package of the C++ node",
    "program": "Path of the C++ program",
}


def debug_profiles(deployment: Deployment) -> dict[str, Any]:
    """Return ``launch.json``: to start and to attach, for C++ and for Python, and the agent itself."""
    ros = deployment.common.ros is not RosDistribution.NONE
    profiles = [*_python(deployment, ros=ros), *_cpp(ros=ros)]
    asked = {name for name in _INPUTS if f"${{input:{name}}}" in str(profiles)}
    inputs = [_input(name) for name in sorted(asked)]
    return {"version": "0.2.0", "configurations": profiles, "inputs": inputs}


def _python(deployment: Deployment, *, ros: bool) -> list[dict[str, Any]]:
    agent = shlex.join(
        (
            *("agent", "up", "--fleet", FLEET_FILE, "--agent", deployment.agent.name),
            *("--interface", deployment.network.agent_interface, "--without", "router"),
        )
    )
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
            "args": f"{agent} {_ARGUMENTS}",
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
    installed = "${workspaceFolder}/install/${input:package}/lib/${input:package}/${input:executable}"
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


def _input(name: str) -> dict[str, Any]:
    return {"id": name, "type": "promptString", "description": _INPUTS[name], "default": ""}


WORKSPACE = "/workspace"
"""Where the user's workspace stands in the container."""

_INITIALIZE = "hooks/initialize.sh"
_USER = "sfglab"


def container_settings(deployment: Deployment) -> dict[str, Any]:
    """Return ``devcontainer.json``.

    The hooks run on the machine, before its containers: they set time, firewall and service, and end with the
    user's own (paper A, section 4.4, "Lifecycle Hooks").
    """
    ros = deployment.common.ros
    settings: dict[str, Any] = {
        "name": f"{deployment.agent.name} ({deployment.fleet.name})",
        "dockerComposeFile": ["../compose.yaml", "../compose.dev.yaml"],
        "service": "agent",
        "runServices": ["agent", "router"],
        "workspaceFolder": WORKSPACE,
        "shutdownAction": "stopCompose",
        # A list runs without a shell, so that no character of the folder's name means anything.
        "initializeCommand": [f"${{localWorkspaceFolder}}/{_INITIALIZE}", "--development"],
        "remoteUser": _USER,
        "customizations": {"vscode": {"extensions": list(EXTENSIONS), "settings": workspace_settings(ros)}},
    }
    if ros is not RosDistribution.NONE:
        settings["postCreateCommand"] = ["bash", "-c", build_command(ros)]
    return settings


def editor_files(deployment: Deployment) -> dict[str, BundleFile]:
    """Return the development container and the settings of VS Code for one agent (paper A, section 4.4).

    All are plain JSON without comments, so that any program reads them.

    Args:
        deployment: The agent. Without ROS in its images nothing of colcon is written.
    """
    ros = deployment.common.ros
    values: dict[str, Any] = {
        ".devcontainer/devcontainer.json": container_settings(deployment),
        ".vscode/extensions.json": {"recommendations": list(EXTENSIONS)},
        ".vscode/launch.json": debug_profiles(deployment),
        ".vscode/settings.json": workspace_settings(ros),
        ".vscode/tasks.json": build_tasks(ros),
    }
    return {name: BundleFile(text=json.dumps(value, indent=2) + "\n") for name, value in values.items()}
