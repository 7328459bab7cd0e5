"""The context of a run: versions, machine, state of the source tree.

Knows what makes two runs comparable. Refuses to record what identifies a place or a person: no path, no host
name.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil

import sfglab

_LIBRARIES = (
    "av",
    "cvxpy",
    "cyclonedds",
    "mcap",
    "numba",
    "numpy",
    "opencv-python-headless",
    "pandas",
    "pyroute2",
    "rosbags",
    "scikit-image",
    "scipy",
)
_GIT_TIMEOUT_S = 10.0


def _versions() -> dict[str, str]:
    installed = {dist.name.lower(): dist.version for dist in metadata.distributions()}
    return {name: installed[name] for name in _LIBRARIES if name in installed}


def _cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
        key, _, value = line.partition(":")
        if key.strip() in {"model name", "Model"}:
            return value.strip()
    return platform.machine()


def _git(*arguments: str, tree: Path) -> str | None:
    """Return what git says about a tree, or None if it knows nothing about it."""
    done = subprocess.run(
        ["git", "-C", str(tree), *arguments],
        capture_output=True,
        text=True,
        timeout=_GIT_TIMEOUT_S,
        check=False,
    )
    return done.stdout.strip() if done.returncode == 0 else None


def _source() -> dict[str, Any]:
    """Return commit and cleanness of the tree that the package is imported from, if it is one."""
    tree = Path(sfglab.__file__).resolve().parent.parent
    # An environment may lie inside the repository of somebody else's project.
    if not shutil.which("git") or _git("rev-parse", "--show-prefix", tree=tree) != "":
        return {}
    commit = _git("rev-parse", "HEAD", tree=tree)
    if commit is None:
        return {}
    return {"git_commit": commit, "git_clean": _git("status", "--porcelain", tree=tree) == ""}


def run_context() -> dict[str, Any]:
    """Return versions, machine and source of this run; experiments write it as the metadata `run`.

    Returns:
        `sfglab` and `python` (versions), `libraries` (name to version), `machine` (cpu, cores, usable_cores,
        kernel, architecture, memory_bytes), and `source` (git_commit, git_clean), empty outside a repository.
    """
    return {
        "sfglab": sfglab.__version__,
        "python": platform.python_version(),
        "libraries": _versions(),
        "machine": {
            "cpu": _cpu_model(),
            "cores": psutil.cpu_count(logical=True),
            "usable_cores": len(os.sched_getaffinity(0)),
            "kernel": f"{platform.system()} {platform.release()}",
            "architecture": platform.machine(),
            "memory_bytes": psutil.virtual_memory().total,
        },
        "source": _source(),
    }
