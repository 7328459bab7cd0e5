"""A real build of an agent's image, without ROS 2 and accelerator, on a Debian that debootstrap makes."""

from __future__ import annotations

import os
import platform
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING

from sfglab.deploy.bases import base_of
from sfglab.deploy.bundle import bundle_of, write_bundle
from sfglab.deploy.deployment import USER_ID
from sfglab.deploy.errors import DeployError
from sfglab.deploy.programs import run_streamed
from sfglab.fleet.fleet_file import Accelerator, Architecture, HostSpec, RosDistribution
from sfglab.lab.experiments.deployment.facts import LOCAL_IMAGE

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.deploy.deployment import Deployment

PROGRAMS = ("buildah", "debootstrap")
_BASE = "localhost/sfglab-trial-base"
_IMAGE = "localhost/sfglab-trial"
_CONTAINER = "trial"


def ask_image(deployment: Deployment, wheel: bytes, folder: Path) -> dict[str, str]:
    """Build an agent's image for this machine, run it, and compare the user and version that it prints.

    Returns:
        The fault by fact; empty if a program, its rights or a Debian is missing.
    """
    if os.geteuid() != 0 or not all(map(shutil.which, PROGRAMS)):
        return {}
    is_arm = platform.machine() == "aarch64"
    host = HostSpec(architecture=Architecture.ARM64 if is_arm else Architecture.AMD64)
    common = replace(deployment.common, ros=RosDistribution.NONE)
    fleet = replace(deployment.fleet, deployment=common)
    made = replace(deployment, fleet=fleet, host=host, accelerator=Accelerator.NONE)
    write_bundle(bundle_of(made, wheel), folder / "context")
    distribution = base_of(made).distribution.value
    debian = ("debootstrap", "--variant=minbase", distribution, f"{folder}/base/root")
    said: list[str] = []
    (folder / "base").mkdir()
    try:
        run_streamed(debian, said.append)
    except DeployError:
        return {}
    (folder / "base" / "Dockerfile").write_text("FROM scratch\nADD root /\n")
    buildah = (
        "buildah",
        "--storage-driver=vfs",
        f"--root={folder}/store",
        f"--runroot={folder}/run",
    )
    build = ("build", "--isolation=chroot", "--target=application")
    run = ("run", "--isolation=chroot", _CONTAINER, "--", "sh", "-c", "id -u; sfglab --version")
    commands = (
        ("build", f"--tag={_BASE}", f"{folder}/base"),
        (*build, f"--tag={_IMAGE}", f"--build-arg=BASE_IMAGE={_BASE}", f"{folder}/context"),
        ("from", "--pull-never", f"--name={_CONTAINER}", _IMAGE),
        run,
    )
    try:
        for command in commands:
            run_streamed([*buildah, *command], said.append)
    except DeployError as error:
        return {LOCAL_IMAGE: str(error)}
    found = said[-2:]
    expected = [str(USER_ID), deployment.release.version]
    fault = "" if found == expected else f"user and version: {', '.join(found)}"
    return {LOCAL_IMAGE: fault}
