"""The part of the project's pinned lock file that a robot needs: no notebooks, no windows, no solvers.

Knows which libraries a robot's components import and how a lock file is written; what those libraries need
in turn comes from their installed metadata.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.fleet.fleet_file import Architecture

if TYPE_CHECKING:
    from collections.abc import Iterable


AGENT_ROOTS = (
    "av",  # sfglab.codecs: H.264
    "cyclonedds",  # sfglab.bus: DDS itself
    "jinja2",  # sfglab.deploy: a robot can render its own files
    "mcap",  # sfglab.record
    "numba",  # sfglab.codecs: RVL
    "numpy",
    "opencv-python-headless",  # sfglab.codecs: PNG and JPEG
    "packaging",  # sfglab.deploy.images: this module
    "psutil",  # sfglab.record: what a run ran on
    "pyyaml",  # fleet files
    "rosbags",  # sfglab.messages: ROS types and CDR
    "scipy",  # sfglab.spatial: trajectories, motion capture
    "tqdm",  # sfglab follow
    "typer",  # the command line
    "uvloop",  # every component's event loop
    "zstandard",  # sfglab.record
)
"""What is imported at run time on a robot; without cvxpy, pandas, Qt, Jupyter and what else plans or shows."""

MACHINES = {Architecture.AMD64: "x86_64", Architecture.ARM64: "aarch64"}
"""What Linux calls a processor."""


@lru_cache(maxsize=16)  # a fleet has few kinds of machine, and what is installed stays
def agent_lock(lock_text: str, *, python: str, architecture: Architecture) -> str:
    """Return the part of a lock file that an agent's image installs, digests included, sorted by name.

    Args:
        lock_text: A lock file in pip's format with a digest for every file, as ``uv pip compile`` writes it.
        python: Version of Python in the image, as in ``3.11``.
        architecture: The image's processor.

    Raises:
        DeployError: Something that an agent needs is not pinned for that Python and processor.
    """
    environment = _environment(python, architecture)
    pinned = _pinned(lock_text, environment)
    needed = _closure(environment)
    missing = sorted(needed - pinned.keys())
    if missing:
        raise DeployError(
            f"requirements.lock: given nothing for Python {python} on {architecture.value} of: "
            f"{', '.join(missing)}; allowed: one pinned version of each (`make lock`)"
        )
    return "".join(pinned[name] for name in sorted(needed))


def split_lock(lock_text: str, names: Iterable[str]) -> tuple[str, str]:
    """Return a lock file's entries without and of some packages.

    Args:
        lock_text: The lock file.
        names: Names in their normal form (PEP 503).
    """
    taken = frozenset(names)
    entries = [(_entry_name(entry), entry) for entry in _entries(lock_text)]
    without = "".join(entry for name, entry in entries if name not in taken)
    return without, "".join(entry for name, entry in entries if name in taken)


def _pinned(lock_text: str, environment: dict[str, str]) -> dict[str, str]:
    """Return the entries that apply, by name, without their markers."""
    from packaging.requirements import Requirement

    pinned = {}
    for entry in _entries(lock_text):
        head, *digests = entry.splitlines(keepends=True)
        requirement = Requirement(_requirement(head))
        if requirement.marker is None or requirement.marker.evaluate(environment):
            plain = f"{requirement.name}{requirement.specifier}"
            pinned[_entry_name(entry)] = "".join((f"{plain} \\\n" if digests else f"{plain}\n", *digests))
    return pinned


def _closure(environment: dict[str, str]) -> set[str]:
    """Return the roots and all that they need on the target."""
    from packaging.utils import canonicalize_name

    needed: set[str] = set()
    waiting = [str(canonicalize_name(root)) for root in AGENT_ROOTS]
    while waiting:
        name = waiting.pop()
        if name not in needed:
            needed.add(name)
            waiting += _requirements(name, environment)
    return needed


def _requirements(name: str, environment: dict[str, str]) -> list[str]:
    from importlib.metadata import PackageNotFoundError, requires

    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    try:
        requirements = [Requirement(text) for text in requires(name) or ()]
    except PackageNotFoundError as error:
        # What only other targets need is not installed here, and then needs nothing that we could know of.
        if name in {str(canonicalize_name(root)) for root in AGENT_ROOTS}:
            raise DeployError(f"{name}: given nothing installed, allowed: sfglab with its libraries") from error
        return []
    return [
        str(canonicalize_name(requirement.name))
        for requirement in requirements
        if requirement.marker is None or requirement.marker.evaluate(environment)
    ]


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


def _entries(lock_text: str) -> list[str]:
    """Return a requirement and its digests, one text each."""
    entries: list[str] = []
    for line in lock_text.splitlines(keepends=True):
        if line.startswith((" ", "\t")) and entries:
            entries[-1] += line
        elif line.strip() and not line.startswith("#"):
            entries.append(line)
    return entries


def _entry_name(entry: str) -> str:
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    return str(canonicalize_name(Requirement(_requirement(entry.splitlines()[0])).name))


def _requirement(head: str) -> str:
    return head.rstrip().removesuffix("\\").rstrip()
