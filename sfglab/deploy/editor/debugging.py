"""Debugging profiles for C++ and Python nodes that forward whole command lines (paper A, section 4.4).

A profile's ``args`` is one text, not a list: CodeLLDB splits it as a shell would (its manual, "Launching a
New Process"), and debugpy hands it to the terminal's shell as it is. In a list, all that the user types would
arrive as one argument.

Attaching to a running C++ node asks the machine for ``kernel.yama.ptrace_scope=0``: the container's user has no
capabilities, so that a debugger may otherwise see its own children only (Linux, admin-guide/LSM/Yama).
"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Any

from sfglab.deploy.editor.ros import ENVIRONMENT_FILE, INTERPRETER
from sfglab.deploy.editor.tasks import BUILD_ALL, ENVIRONMENT, FLEET_FILE
from sfglab.fleet.fleet_file import RosDistribution

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


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
