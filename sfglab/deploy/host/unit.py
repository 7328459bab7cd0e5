"""The systemd unit that starts an agent's containers with its machine (paper A, section 4.4)."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.templates import render

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


_UNSAFE = re.compile(r"[^\w .:()-]+", re.ASCII)


def project_name(deployment: Deployment) -> str:
    """Return the name under which Compose keeps the agent's containers."""
    return f"sfglab-{deployment.agent.name}"


def service_unit(deployment: Deployment) -> str:
    """Return the unit's text.

    Args:
        deployment: The agent on its machine.
    """
    project = project_name(deployment)
    return render(
        "sfglab.deploy.host",
        "agent.service",
        agent=deployment.agent.name,
        # For people only; systemd gives '%', quotes and backslashes a meaning.
        fleet=_UNSAFE.sub(" ", deployment.fleet.name).strip(),
        service=deployment.service,
        folder=deployment.folder,
        project=project,
        options=f"--project-name {project}",
    )
