"""What VS Code builds and checks: the colcon workspace and the fleet's files.

Format: schema of tasks.json, version 2.0.0 (code.visualstudio.com, "Appendix").
"""

from __future__ import annotations

from typing import Any

from sfglab.deploy.editor.ros import build_command, environment_command, sourced
from sfglab.fleet.fleet_file import RosDistribution

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
    return {"version": "2.0.0", "tasks": [*(_colcon(ros) if ros is not RosDistribution.NONE else ()), check]}


def _colcon(ros: RosDistribution) -> tuple[dict[str, Any], ...]:
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
