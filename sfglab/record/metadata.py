"""Metadata of a run: versions and machine, and values and QoS profiles as the strings that MCAP stores.

The metadata shows whether two runs are comparable. It identifies no place and no person: it has no path and no
host name.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

import sfglab
from sfglab.fields import to_json
from sfglab.qos import Durability, History, Liveliness, QoSProfile, Reliability
from sfglab.record.parts import LogError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping
    from enum import Enum

    from rosbags.interfaces import Qos, QosTime


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


def library_versions() -> dict[str, str]:
    """Return the versions of the installed libraries that results depend on."""
    versions = {}
    for name in _LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions


def _cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
        key, _, value = line.partition(":")
        if key.strip() in {"model name", "Model"}:
            return value.strip()
    return platform.machine()


def git(tree: Path, *arguments: str) -> str | None:
    """Return the output of a git command in a tree; None if it fails, takes too long, or git is not installed."""
    command = ["git", "-C", str(tree), *arguments]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_GIT_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def _source() -> dict[str, Any]:
    """Return commit and state of the repository that the package is imported from; empty if there is none."""
    tree = Path(sfglab.__file__).resolve().parent.parent
    # An environment may be inside the repository of another project.
    if (
        git(tree, "rev-parse", "--show-prefix") != ""
        or (commit := git(tree, "rev-parse", "HEAD")) is None
    ):
        return {}
    return {"git_commit": commit, "git_clean": git(tree, "status", "--porcelain") == ""}


def run_context() -> dict[str, Any]:
    """Return versions, machine and source of this run; experiments write it as the metadata `run`.

    It has `sfglab` and `python` (versions), `libraries` (name to version), `machine` (cpu, cores, usable_cores,
    kernel, architecture, memory_bytes), and `source` (git_commit, git_clean), empty outside a repository.
    """
    return {
        "sfglab": sfglab.__version__,
        "python": platform.python_version(),
        "libraries": library_versions(),
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


_POLICIES: dict[str, type[Enum]] = {
    "history": History,
    "reliability": Reliability,
    "durability": Durability,
    "liveliness": Liveliness,
}
_INFINITE_NS = 2**63 - 1


def offered_qos_profiles(qos: QoSProfile) -> str:
    """Return a QoS profile as rosbag2's YAML: a list of one profile, with numbers for policies as in Humble."""
    from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability

    return (
        f"- history: {QosHistory[qos.history.name].value}\n"
        f"  depth: {qos.depth}\n"
        f"  reliability: {QosReliability[qos.reliability.name].value}\n"
        f"  durability: {QosDurability[qos.durability.name].value}\n"
        f"  deadline: {_duration_yaml(qos.deadline_ns)}\n"
        f"  lifespan: {_duration_yaml(qos.lifespan_ns)}\n"
        f"  liveliness: {QosLiveliness[qos.liveliness.name].value}\n"
        f"  liveliness_lease_duration: {_duration_yaml(qos.lease_ns)}\n"
        "  avoid_ros_namespace_conventions: false\n"
    )


def _duration_yaml(duration_ns: int | None) -> str:
    sec, nsec = divmod(_INFINITE_NS if duration_ns is None else duration_ns, NS_PER_S)
    return f"{{sec: {sec}, nsec: {nsec}}}"


def profile_from_bag(text: str) -> QoSProfile:
    """Return the first QoS profile in rosbag2's YAML.

    Missing values, and all values of a text that cannot be read, are those of ROS 2's default profile.
    """
    from rosbags.rosbag2.errors import ReaderError
    from rosbags.rosbag2.metadata import parse_qos

    wrong = (ReaderError, LookupError, TypeError, ValueError, AttributeError, RecursionError)
    try:
        return _profile(parse_qos(text)[0])
    except wrong:
        return QoSProfile()


def _profile(offered: Qos) -> QoSProfile:
    policies: dict[str, Any] = {}
    for name, kinds in _POLICIES.items():
        # Unknown and best-available policies, which rosbags names as well, stay at the default.
        if kind := kinds.__members__.get(getattr(offered, name).name):
            policies[name] = kind
    if 0 < offered.depth < 2**31:
        policies["depth"] = int(offered.depth)
    return QoSProfile(
        **policies,
        deadline_ns=_duration_ns(offered.deadline),
        lifespan_ns=_duration_ns(offered.lifespan),
        lease_ns=_duration_ns(offered.liveliness_lease_duration),
    )


def _duration_ns(given: QosTime) -> int | None:
    time_ns = given.sec * NS_PER_S + given.nsec
    return time_ns if 0 < time_ns < _INFINITE_NS else None


def _plain(value: Any) -> Any:
    """Return the JSON form of a value whose type JSON does not have."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    plain = to_json(value)
    if plain is value:
        raise TypeError(f"{type(value).__name__} has no form in JSON")
    return plain


def _is_literal(text: str) -> bool:
    """Return whether a text is valid JSON, and so would be read as another value."""
    try:
        json.loads(text)
    except (ValueError, RecursionError):  # also numbers and nesting that Python does not read
        return False
    return True


def strings_from_values(name: str, values: Mapping[str, Any]) -> dict[str, str]:
    """Return a mapping whose values are strings: text unchanged, other values as JSON, in the same order.

    Text that is valid JSON is quoted, so that `values_from_strings` returns the same value. Values may be text,
    numbers, None, lists, mappings, enums, dataclasses and NumPy values, also nested. Tuples and arrays become
    lists, dataclasses become mappings, and keys become text.

    Args:
        name: Name of the record in errors.
        values: The mapping.

    Raises:
        LogError: A value is of another type, or a text is not valid Unicode.
    """
    strings = {}
    for key, value in values.items():
        is_text = type(value) is str and not _is_literal(value)
        try:
            text = value if is_text else json.dumps(value, default=_plain)
            f"{key}{text}".encode()  # a lone surrogate cannot be stored
            strings[str(key)] = text
        except (TypeError, ValueError) as exc:
            raise LogError(f"metadata {name!r}: {key!r} cannot be kept: {exc}") from exc
    return strings


def values_from_strings(strings: Mapping[str, str]) -> dict[str, Any]:
    """Return the mapping that `strings_from_values` turned into strings."""
    return {key: json.loads(text) if _is_literal(text) else text for key, text in strings.items()}
