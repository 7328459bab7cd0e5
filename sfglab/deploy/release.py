"""A release: sfglab's wheel, and the part of the project's pinned lock file that a robot needs."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import sfglab
from sfglab.deploy.deployment import Release
from sfglab.deploy.errors import DeployError
from sfglab.fleet.fleet_file import Architecture
from sfglab.record.metadata import git

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from packaging.requirements import Requirement


AGENT_ROOTS = (  # by their normal names (PEP 503)
    "av",  # sfglab.codecs: H.264
    "cyclonedds",  # sfglab.bus: DDS itself
    "jinja2",  # sfglab.deploy: a robot can render its own files
    "lz4",  # sfglab.record
    "mcap",  # sfglab.record
    "numba",  # sfglab.codecs: RVL
    "numpy",
    "opencv-python-headless",  # sfglab.codecs: PNG and JPEG
    "packaging",  # sfglab.deploy.release: this module
    "psutil",  # sfglab.record: what a run ran on
    "pydantic",  # fleet files: checked
    "pyyaml",  # fleet files
    "rosbags",  # sfglab.messages: ROS types and CDR
    "scipy",  # sfglab.spatial: trajectories, motion capture
    "tqdm",  # sfglab follow
    "typer",  # the command line
    "uvloop",  # every component's event loop
    "zstandard",  # sfglab.record
)
"""Packages that a robot imports at run time: none that only plan or display, such as cvxpy, pandas and Qt."""

#: Further packages of a robot whose fleet meets over Zenoh; those of the extra ``zenoh`` of ``sfglab-robot``.
ZENOH_ROOTS = ("eclipse-zenoh", "xxhash")

#: Name of a processor in Linux, by architecture.
MACHINES = {Architecture.AMD64: "x86_64", Architecture.ARM64: "aarch64"}


@lru_cache(maxsize=16)  # a fleet has few kinds of machine, and what is installed stays
def agent_lock(
    lock_text: str, *, python: str, architecture: Architecture, zenoh: bool = False
) -> str:
    """Return the part of a lock file that an agent's image installs, digests included, sorted by name.

    Args:
        lock_text: Lock file in the form of ``uv pip compile``.
        python: Version of Python, such as ``3.11``.
        architecture: Processor of the target host.
        zenoh: Whether the agents meet over Zenoh.

    Raises:
        DeployError: A package of an agent has no pinned version for that Python and processor, or it is
            missing here.
    """
    environment = _environment(python, architecture)
    pinned = {}
    for requirement, entry in _entries(lock_text):
        if _applies(requirement, environment):
            _, *digests = entry.splitlines(keepends=True)
            end = " \\\n" if digests else "\n"
            head = f"{requirement.name}{requirement.specifier}{end}"
            pinned[_name(requirement)] = "".join((head, *digests))
    needed = _closure((*AGENT_ROOTS, *ZENOH_ROOTS) if zenoh else AGENT_ROOTS, environment)
    missing = sorted(needed - pinned.keys())
    if missing:
        raise DeployError(
            f"requirements.lock: there is no version for Python {python} on {architecture.value} of "
            f"{', '.join(missing)}; run `make lock`"
        )
    return "".join(pinned[name] for name in sorted(needed))


def split_lock(lock_text: str, names: Iterable[str]) -> tuple[str, str]:
    """Split the entries of a lock file: those of other packages, and those of the named packages.

    The names are normalised as in PEP 503.
    """
    taken = frozenset(names)
    without, of = "", ""
    for requirement, entry in _entries(lock_text):
        if _name(requirement) in taken:
            of += entry
        else:
            without += entry
    return without, of


@lru_cache(maxsize=16)
def _entries(lock_text: str) -> tuple[tuple[Requirement, str], ...]:
    """Return each requirement of a lock file, and its text with its digests."""
    from packaging.requirements import Requirement

    entries: list[str] = []
    for line in lock_text.splitlines(keepends=True):
        if line.startswith((" ", "\t")) and entries:
            entries[-1] += line
        elif line.strip() and not line.startswith("#"):
            entries.append(line)
    return tuple(
        (Requirement(one.partition("\n")[0].rstrip().removesuffix("\\")), one) for one in entries
    )


def _name(requirement: Requirement) -> str:
    from packaging.utils import canonicalize_name

    return str(canonicalize_name(requirement.name))


def _applies(requirement: Requirement, environment: dict[str, str]) -> bool:
    return requirement.marker is None or requirement.marker.evaluate(environment)


def _closure(roots: Sequence[str], environment: dict[str, str]) -> set[str]:
    """Return the names of the root packages and of all packages that they need on the target host."""
    from importlib.metadata import PackageNotFoundError, requires

    from packaging.requirements import Requirement

    needed: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name in needed:
            continue
        needed.add(name)
        try:
            requirements = map(Requirement, requires(name) or ())
        except PackageNotFoundError as error:
            if name in roots:
                part = "the extra zenoh" if name in ZENOH_ROOTS else "its dependencies"
                raise DeployError(
                    f"{name}: this package is not installed; install sfglab with {part}"
                ) from error
            # Packages that only other targets need are not installed; their requirements are unknown.
            continue
        waiting += [_name(one) for one in requirements if _applies(one, environment)]
    return needed


def _environment(python: str, architecture: Architecture) -> dict[str, str]:
    """Return the target's environment markers (PEP 508)."""
    return {
        "extra": "",
        "implementation_name": "cpython",
        "implementation_version": f"{python}.0",
        "os_name": "posix",
        "platform_machine": MACHINES[architecture],
        "platform_python_implementation": "CPython",
        "platform_release": "",
        "platform_system": "Linux",
        "platform_version": "",
        "python_full_version": f"{python}.0",
        "python_version": python,
        "sys_platform": "linux",
    }


#: Folder of the released project: a checkout, or the folder in which a wheel is installed.
SOURCE = Path(sfglab.__file__).parents[1]

LOCK_FILE = "install/requirements.lock"

# any moment after 1980, where ZIP's clock starts: the same one in every wheel
_EPOCH_S = 1580601600
_BUILD_LIMIT_S = 120.0
_BACKEND = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"


def build_wheel(project: Path, folder: Path) -> Path:
    """Build a project's wheel with the project's own backend (PEP 517), without network, and return its path.

    Args:
        project: Folder of the project.
        folder: Folder for the wheel.

    Raises:
        DeployError: The wheel cannot be built.
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
        raise DeployError(
            f"{project}: the wheel cannot be built ({error}); run `make robot` to see the cause"
        ) from error
    if built.returncode != 0:
        last = built.stderr.strip().splitlines()[-1:]
        raise DeployError(
            f"{project}: the wheel cannot be built ({' '.join(last)}); use a checkout of sfglab, with "
            "hatchling installed"
        )
    return folder / built.stdout.strip().splitlines()[-1]


def make_release(project: Path, fleet_text: str) -> tuple[Release, bytes]:
    """Return the release of a project for a fleet file, and the content of its wheel.

    Args:
        project: Folder of the project.
        fleet_text: Text of the fleet file.

    Raises:
        DeployError: The wheel cannot be built.
    """
    with tempfile.TemporaryDirectory(prefix="sfglab-wheel-") as folder:
        source = _buildable(project, Path(folder) / "source")
        lock = source / LOCK_FILE
        if not lock.is_file():
            raise DeployError(
                f"{lock}: this file is missing; use a checkout of sfglab or an installed wheel of it"
            )
        wheel = build_wheel(source, Path(folder))
        name, data, locked = wheel.name, wheel.read_bytes(), lock.read_text(encoding="utf-8")
    revision = git(project, "rev-parse", "HEAD") or ""
    if revision and git(project, "status", "--porcelain"):
        revision += "-dirty"
    release = Release(
        version=sfglab.__version__,
        wheel=name,
        wheel_sha256=hashlib.sha256(data).hexdigest(),
        lock=locked,
        fleet_text=fleet_text,
        revision=revision,
        created=git(project, "log", "-1", "--format=%cI") or "",
    )
    return release, data


def _buildable(project: Path, folder: Path) -> Path:
    """Return a folder from which a wheel can be built: that of a checkout, or a copy of an installed package."""
    carried = project / "sfglab" / "deploy" / "source"
    if (project / LOCK_FILE).is_file() or not carried.is_dir():
        return project
    ignored = shutil.ignore_patterns("__pycache__", carried.name)
    shutil.copytree(project / "sfglab", folder / "sfglab", ignore=ignored)
    return shutil.copytree(carried, folder, dirs_exist_ok=True)
