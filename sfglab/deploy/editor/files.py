"""The files that VS Code reads in an agent's folder; refuses to know what stands in each."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from sfglab.deploy.editor.container import container_settings
from sfglab.deploy.editor.debugging import debug_profiles
from sfglab.deploy.editor.settings import EXTENSIONS, workspace_settings
from sfglab.deploy.editor.tasks import build_tasks
from sfglab.deploy.files import BundleFile

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


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
