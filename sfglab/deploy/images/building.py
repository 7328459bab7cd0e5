"""Building an agent's images with whichever builder a machine has.

Knows three builders' command lines; refuses to know what is in the images.
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.deploy.deployment import Deployment


BUILDERS: dict[str, tuple[str, ...]] = {
    "docker": ("docker", "build"),
    "podman": ("podman", "build"),
    "buildah": ("buildah", "build"),
}
"""How each builder is called, the preferred one first."""


def build_command(  # noqa: PLR0913 - each is a word of the command line
    folder: Path,
    deployment: Deployment,
    tag: str,
    *,
    tool: str,
    target: str = "application",
    base_image: str | None = None,
    offline: bool = False,
) -> list[str]:
    """Return the command that builds an agent's image.

    Args:
        folder: The agent's files.
        deployment: The agent on its machine.
        tag: Of the image.
        tool: One of `BUILDERS`.
        target: The stage.
        base_image: An image at hand in place of the pinned one; None takes that.
        offline: Take Python packages from ``image/wheels`` alone.

    Raises:
        DeployError: There is no such builder.
    """
    if tool not in BUILDERS:
        raise DeployError(f"builder: given {tool!r}, allowed: {', '.join(BUILDERS)}")
    arguments = [f"BASE_IMAGE={base_image}"] * (base_image is not None) + ["OFFLINE=1"] * offline
    return [
        *BUILDERS[tool],
        *(("--layers",) if tool != "docker" else ()),  # docker keeps layers without being asked
        f"--platform=linux/{deployment.host.architecture.value}",
        f"--target={target}",
        f"--tag={deployment.repository}:{tag}",
        *(f"--build-arg={argument}" for argument in arguments),
        f"--file={folder / 'Dockerfile'}",
        str(folder),
    ]


def find_builder() -> str | None:
    """Return the first builder that this machine has; None if it has none."""
    return next((tool for tool in BUILDERS if shutil.which(tool)), None)
