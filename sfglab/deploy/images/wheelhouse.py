"""Wheels fetched beforehand, for robots on networks without a package index."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.images.lock import MACHINES

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import Architecture


_GLIBC_MINORS = (17, 24, 26, 27, 28, 31, 34, 35)
"""Wheels for these versions of glibc 2 and older run on all our bases: the oldest, Ubuntu 22.04, has 2.35."""


def wheelhouse(lock: str, folder: Path, python: str, architecture: Architecture) -> tuple[Path, ...]:
    """Fetch the wheels of a lock file for another machine, each by its digest; return where they are.

    Args:
        lock: The lock file, as an image has it.
        folder: Where they are put, as in ``image/wheels``; made if it is not there.
        python: Version of Python in the image, as in ``3.11``.
        architecture: The image's processor.

    Raises:
        DeployError: Something cannot be fetched, as for want of a wheel for that machine.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="sfglab-lock-") as scratch:
        file = Path(scratch) / "requirements.lock"
        file.write_text(lock, encoding="utf-8")
        fetched = subprocess.run(
            _command(file, folder, python, MACHINES[architecture]), capture_output=True, text=True, check=False
        )
    if fetched.returncode != 0:
        said = [line for line in fetched.stderr.splitlines() if line.startswith("ERROR")] or ["nothing"]
        raise DeployError(f"wheels for Python {python} on {architecture.value}: pip said {said[0]!r}")
    return tuple(sorted(folder.glob("*.whl")))


def _command(file: Path, folder: Path, python: str, machine: str) -> list[str]:
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in _GLIBC_MINORS]
    return [
        *(sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"),
        *("--no-deps", "--require-hashes", "--only-binary=:all:", f"--python-version={python}"),
        "--implementation=cp",
        *(f"--platform={platform}" for platform in (*platforms, f"manylinux2014_{machine}")),
        *(f"--dest={folder}", f"--requirement={file}"),
    ]
