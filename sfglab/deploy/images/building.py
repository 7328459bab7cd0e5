"""Building an agent's images with whichever builder a machine has.

Knows three builders' command lines; refuses to know what is in the images. A build that is interrupted ends
with all that it started.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
from collections import deque
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from sfglab.deploy.deployment import Deployment

__all__ = ["BUILDERS", "build", "build_command", "find_builder", "run_streaming"]

BUILDERS: dict[str, tuple[str, ...]] = {
    "docker": ("docker", "build"),
    "podman": ("podman", "build"),
    "buildah": ("buildah", "build"),
}
"""How each builder is called, the preferred one first."""

_GRACE_S = 10.0
_LAST_WORDS = 20


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


def build(command: Sequence[str], say: Callable[[str], None]) -> None:
    """Run a build, and hand on each line that it says.

    Raises:
        DeployError: It failed, or its builder is not installed.
    """
    last: deque[str] = deque(maxlen=_LAST_WORDS)

    def hear(line: str) -> None:
        last.append(line)
        say(line)

    status = run_streaming(command, hear)
    if status != 0:
        words = "\n".join(last)
        raise DeployError(f"{command[0]}: the build ended with status {status}; its last words:\n{words}")


def run_streaming(command: Sequence[str], hear: Callable[[str], None]) -> int:
    """Run a program, hear its lines, and return its status; interrupted, it ends with its children.

    Raises:
        DeployError: There is no such program.
    """
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
    except OSError as error:
        raise DeployError(f"{command[0]}: given a program that does not start: {error}") from error
    assert process.stdout is not None
    try:
        for line in process.stdout:
            hear(line.rstrip("\n"))
        return process.wait()
    except BaseException:
        _end(process)
        raise
    finally:
        process.stdout.close()


def _end(process: subprocess.Popen[str]) -> None:
    """End a program and all of its session: first asked, then made to."""
    for how, limit_s in ((signal.SIGTERM, _GRACE_S), (signal.SIGKILL, None)):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, how)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(limit_s)
            break
    # The leader has ended; what it started may have not.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
