"""What is released: sfglab's wheel, and the name of all that goes into an image.

Knows the project's folder and its history; refuses to know machines. Two builds of the same commit give the
same wheel, byte by byte.
"""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import sfglab
from sfglab.deploy.deployment import Release
from sfglab.deploy.errors import DeployError
from sfglab.deploy.images.dockerfile import image_files

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


SOURCE = Path(sfglab.__file__).parents[1]
"""The folder that this package runs from: what is released is what runs here, if it is a checkout."""

LOCK_FILE = "requirements.lock"

_EPOCH_S = 1580601600  # any moment after 1980, where ZIP's clock starts: the same one in every wheel
_BUILD_LIMIT_S = 120.0
_DIGITS = 12
_BACKEND = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"


def build_wheel(project: Path, folder: Path) -> Path:
    """Build sfglab's wheel by its own backend (PEP 517), without network, and return where it is.

    Args:
        project: The folder with ``pyproject.toml``.
        folder: Where the wheel is put; made if it is not there.

    Raises:
        DeployError: The project cannot be built.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        built = subprocess.run(
            [sys.executable, "-c", _BACKEND, str(folder.resolve())],
            cwd=project,
            env=os.environ | {"SOURCE_DATE_EPOCH": str(_EPOCH_S)},
            capture_output=True,
            text=True,
            timeout=_BUILD_LIMIT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DeployError(f"{project}: wheel: {error}") from error
    if built.returncode != 0:
        said = (built.stderr.strip().splitlines() or ["nothing"])[-1]
        raise DeployError(
            f"{project}: wheel: hatchling said {said!r}; allowed: sfglab's folder, with hatchling installed"
        )
    return folder / built.stdout.strip().splitlines()[-1]


def make_release(project: Path, fleet_text: str) -> tuple[Release, bytes]:
    """Return what a project's folder releases as it stands, and the bytes of its wheel.

    Args:
        project: The folder with ``pyproject.toml`` and ``requirements.lock``.
        fleet_text: The fleet file.

    Raises:
        DeployError: The project cannot be built, or has no lock file.
    """
    lock = project / LOCK_FILE
    if not lock.is_file():
        raise DeployError(f"{lock}: given no such file, allowed: a checkout of sfglab, which has a lock file")
    with tempfile.TemporaryDirectory(prefix="sfglab-wheel-") as folder:
        wheel = build_wheel(project, Path(folder))
        name, data = wheel.name, wheel.read_bytes()
    release = Release(
        version=sfglab.__version__,
        wheel=name,
        wheel_sha256=hashlib.sha256(data).hexdigest(),
        lock=lock.read_text(encoding="utf-8"),
        fleet_text=fleet_text,
        revision=_revision(project),
        created=_git(project, "log", "-1", "--format=%cI"),
    )
    return release, data


def release_tag(deployment: Deployment) -> str:
    """Return the name of what goes into an agent's image: the version and 12 digits of a digest of it all.

    Raises:
        DeployError: There is no image for the agent.
    """
    digest = hashlib.sha256(deployment.release.wheel_sha256.encode())
    for path, file in sorted(image_files(deployment).items()):
        for part in (path, file.text, str(file.mode)):
            digest.update(hashlib.sha256(part.encode()).digest())
    # What a tag may not have (OCI Distribution Specification 1.1, "Pulling manifests"), such as a plus sign.
    version = re.sub(r"[^\w.-]", "-", deployment.release.version, flags=re.ASCII)
    return f"{version}-{digest.hexdigest()[:_DIGITS]}"


def _revision(project: Path) -> str:
    revision = _git(project, "rev-parse", "HEAD")
    return f"{revision}-dirty" if revision and _git(project, "status", "--porcelain") else revision


def _git(project: Path, *arguments: str) -> str:
    """Return what git says of a folder; nothing where there is no git or no history."""
    try:
        said = subprocess.run(
            ["git", "-C", str(project), *arguments], capture_output=True, text=True, check=False
        )
    except OSError:
        return ""
    return said.stdout.strip() if said.returncode == 0 else ""
