"""Files from which an agent's images are built; contents have digests, so equal files give equal images."""

from __future__ import annotations

import hashlib
import json

from sfglab.deploy.bases import BaseImage, base_of
from sfglab.deploy.deployment import FLEET_FILE, USER, USER_ID, Deployment
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import PROGRAM, BundleFile, one_line, render, text_file
from sfglab.deploy.release import agent_lock, split_lock
from sfglab.fleet.fleet_file import Architecture, RosDistribution

STAGES = ("base", "adapter", "application")  #: The three layers of the paper, in their order.

VENV = "/opt/venv"
OVERLAY = "/opt/workspace"  #: Folder of the user's installed colcon workspace.

_LICENCE = "Apache-2.0"  # LICENSE
_TOOLS = ("cmakelang", "debugpy", "six")  # formats CMake (and needs six); debugs Python
_WHEELS_NOTE = """Wheels for machines without a package index.

What pip finds here it takes instead of downloading, if its digest is in requirements.lock. Built with the
argument OFFLINE=1, nothing is downloaded at all.
"""


_CYCLONE = {
    "version": "11.0.1",  # tag of the source, and version of the Python binding on PyPI
    "commit": "e54e991f75a3e67f8e628da3171122e36ea5b872",  # of the tag
    "repository": "https://github.com/eclipse-cyclonedds/cyclonedds.git",
    "prefix": "/opt/cyclonedds",
}
"""Eclipse Cyclone DDS as source."""

_ROS = {
    "archive": "http://packages.ros.org/ros2/ubuntu",
    "key": "https://raw.githubusercontent.com/ros/rosdistro/master/ros.key",
    "fingerprint": "C1CF6E31E6BADE8868B172B4F42ED6FBAB17C654",
}
"""Debian packages of ROS 2, and the key that signs them, with its fingerprint as Open Robotics publishes it."""

_ROS_PACKAGES = ("ros-base", "rmw-cyclonedds-cpp", "ffmpeg-image-transport")
_COLCON = "python3-colcon-common-extensions"

_CYCLONE_BUILD_LOCK = """wheel==0.45.1 \\
    --hash=sha256:708e7481cc80179af0e556bbf0cc00b8444c7321e2700b8d8580231d13017248
"""
"""Requirement of the binding's build beside setuptools, which the project's lock pins."""


def image_files(deployment: Deployment) -> dict[str, BundleFile]:
    """Return the files from which an agent's images are built, except sfglab's wheel.

    Raises:
        DeployError: There is no base image for the agent, or a package has no pinned version.
    """
    base = base_of(deployment)
    locks = _locks(deployment, base)
    texts = {
        "Dockerfile": _dockerfile(deployment, base, locks),
        ".dockerignore": _dockerignore(deployment, (*locks, "image/wheels")),
        **locks,
        "image/fleet.yaml": deployment.release.fleet_text,
        "image/wheels/README": _WHEELS_NOTE,
    }
    files = {path: text_file(text) for path, text in texts.items()}
    files["image/entrypoint.sh"] = text_file(_entrypoint(deployment), PROGRAM)
    return files


def _locks(deployment: Deployment, base: BaseImage) -> dict[str, str]:
    release = deployment.release
    lock = agent_lock(
        release.lock,
        python=base.python,
        architecture=deployment.host.architecture,
        zenoh=deployment.fleet.zenoh is not None,
    )
    _, development = split_lock(release.lock, _TOOLS)
    locks = {"image/requirements.lock": lock, "image/development.lock": development}
    if _from_source(deployment):
        rest, source = split_lock(lock, ("cyclonedds",))
        if f"=={_CYCLONE['version']} " not in source:
            raise DeployError(
                f"requirements.lock: cyclonedds: given {source.split()[0]!r}, allowed on arm64: version "
                f"{_CYCLONE['version']}, which is built from source there"
            )
        _, setuptools = split_lock(release.lock, ("setuptools",))
        locks["image/requirements.lock"] = rest
        locks["image/cyclonedds.lock"] = source
        locks["image/cyclonedds-build.lock"] = setuptools + _CYCLONE_BUILD_LOCK
    return locks


def _from_source(deployment: Deployment) -> bool:
    """Return whether Cyclone DDS must be compiled: PyPI has Linux wheels of 11.0.1 for x86-64 alone."""
    return deployment.host.architecture is Architecture.ARM64


def _dockerfile(deployment: Deployment, base: BaseImage, locks: dict[str, str]) -> str:
    host = deployment.host
    ros = _ros(deployment)
    headers = f"{base.python_packages[0]}-dev"
    build = ["build-essential", "cmake", "git"]
    debug = ["build-essential", "clang-format", "clangd", "cmake", "gdb", "git", headers]
    common = ["ca-certificates", "ffmpeg", *base.python_packages]
    if ros:
        debug.append(_COLCON)
        common += [f"ros-{ros['distribution']}-{name}" for name in _ROS_PACKAGES]
    command = ["agent", "up", "--fleet", FLEET_FILE, "--agent", deployment.agent.name]
    cyclone = ["build-essential", "ca-certificates", "cmake", "git", *base.python_packages, headers]
    labels = _labels(deployment, base, locks)
    return render(
        "Dockerfile.j2",
        agent=deployment.agent.name,
        fleet=one_line(deployment.fleet.name),
        accelerator=deployment.accelerator.value,
        architecture=host.architecture.value,
        base=base,
        environment=[(name, _quoted(value)) for name, value in base.environment],
        from_source=_from_source(deployment),
        cyclone={**_CYCLONE, "packages": cyclone},
        ros=ros,
        common_packages=common,
        workspace=host.workspace,
        overlay=OVERLAY,
        host_packages=list(host.packages),
        build_packages=[*build, _COLCON],
        development_packages=debug,
        digests={path.removeprefix("image/"): _sha256(text) for path, text in locks.items()},
        release=deployment.release,
        user={"name": USER, "id": USER_ID},
        venv=VENV,
        fleet_file=FLEET_FILE,
        labels=[(name, _quoted(value)) for name, value in labels.items()],
        command=json.dumps(command),
    )


def _ros(deployment: Deployment) -> dict[str, str]:
    """Return the entry of ROS 2's package repository for the distribution; empty without ROS 2.

    Raises:
        DeployError: The agent has a colcon workspace, and the fleet has no ROS 2 distribution.
    """
    distribution = deployment.common.ros
    if distribution is not RosDistribution.NONE:
        return {**_ROS, "distribution": distribution.value}
    if deployment.host.workspace:
        known = [member.value for member in RosDistribution if member is not distribution]
        raise DeployError(
            f"{deployment.host.place}.workspace: given {deployment.host.workspace!r} in a fleet whose "
            f"deployment.ros is 'none', allowed with a colcon workspace: {', '.join(known)}"
        )
    return {}


def _labels(deployment: Deployment, base: BaseImage, locks: dict[str, str]) -> dict[str, str]:
    """Return the labels of an image (OCI Image Specification, "Annotations")."""
    release = deployment.release
    standard = {
        "title": f"sfglab agent {deployment.agent.name}",
        "version": release.version,
        "revision": release.revision,
        "created": release.created,
        "base.name": base.image,
        "licenses": _LICENCE,
    }
    own = {
        "agent": deployment.agent.name,
        "fleet": deployment.fleet.name,
        "accelerator": deployment.accelerator.value,
        "lock.sha256": _sha256(locks["image/requirements.lock"]),
        "wheel.sha256": release.wheel_sha256,
        "fleet.sha256": _sha256(release.fleet_text),
    }
    labels = {
        f"org.opencontainers.image.{name}": value for name, value in standard.items() if value
    }
    return labels | {f"io.sfglab.{name}": value for name, value in own.items()}


def _entrypoint(deployment: Deployment) -> str:
    ros = _ros(deployment)
    scripts = [f"/opt/ros/{ros['distribution']}/setup.sh", f"{OVERLAY}/setup.sh"] if ros else []
    return render(
        "entrypoint.sh.j2", launch=deployment.host.launch, setup_scripts=scripts, venv=VENV
    )


def _dockerignore(deployment: Deployment, paths: tuple[str, ...]) -> str:
    wheel = f"image/{deployment.release.wheel}"
    wanted = [*paths, "image/entrypoint.sh", "image/fleet.yaml", wheel]
    if deployment.host.workspace:
        wanted.append("workspace/src")
    lines = ["# Only what the Dockerfile names reaches the builder.", "*"]
    lines += [f"!{path}" for path in sorted(wanted)]
    return "\n".join(lines) + "\n"


def _quoted(value: str) -> str:
    """Quote a value for a Dockerfile, where a dollar sign stands for a variable even inside quotes."""
    return json.dumps(value).replace("$", "\\$")


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
