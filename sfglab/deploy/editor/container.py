"""The development container: which of the agent's containers VS Code joins, and what happens before and after.

Format: Dev Container metadata reference (containers.dev, development container specification).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.deploy.editor.ros import build_command
from sfglab.deploy.editor.settings import EXTENSIONS, workspace_settings
from sfglab.fleet.fleet_file import RosDistribution

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


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
