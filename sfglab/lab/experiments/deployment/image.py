"""A real build of an agent's image from a base image that is made here.

ROS 2's packages and the vendors' base images are left out, because a machine may not reach them. The agent is
built without ROS 2 and accelerator, for this machine's processor, on a Debian that debootstrap makes.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.bases import base_of
from sfglab.deploy.bundle import bundle_of, write_bundle
from sfglab.deploy.deployment import USER_ID
from sfglab.deploy.errors import DeployError
from sfglab.deploy.programs import run_streamed
from sfglab.deploy.release import MACHINES
from sfglab.fleet.fleet_file import Accelerator, RosDistribution
from sfglab.lab.experiments.deployment.facts import Answer, Outcome, answer

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment

PROGRAMS = ("buildah", "debootstrap")
_BASE = "localhost/sfglab-trial-base"
_IMAGE = "localhost/sfglab-trial"


def ask_image(deployment: Deployment, wheel: bytes, folder: Path) -> Answer:
    """Build an agent's application image, and ask it for its user and its version."""
    installed = all(map(shutil.which, PROGRAMS))
    architectures = {name: known for known, name in MACHINES.items()}
    architecture = architectures.get(platform.machine())
    if not installed or os.geteuid() != 0 or architecture is None:
        return Answer(outcome=Outcome.MISSING)
    common = replace(deployment.common, ros=RosDistribution.NONE)
    host = replace(deployment.host, architecture=architecture, workspace="", packages=())
    fleet = replace(deployment.fleet, deployment=common)
    made = replace(deployment, fleet=fleet, host=host, accelerator=Accelerator.NONE)
    store = _Store(folder / "store")
    try:
        store.make_base(base_of(made).distribution.value, folder / "base")
    except DeployError as error:
        return Answer(outcome=Outcome.MISSING, detail=str(error))
    try:
        write_bundle(bundle_of(made, wheel), folder / "context")
        options = ("--target=application", f"--build-arg=BASE_IMAGE={_BASE}")
        store.build(_IMAGE, folder / "context", *options)
        user, version = store.run("id", "-u"), store.run("sfglab", "--version")
    except DeployError as error:
        return answer(str(error))
    finally:
        store.remove()
    expected = (str(USER_ID), deployment.release.version)
    return answer("" if (user, version) == expected else f"user {user}, version {version}")


class _Store:
    """Images of buildah in a folder, apart from those of the machine."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        places = ("--root", str(folder / "root"), "--runroot", str(folder / "run"))
        self._command = ["buildah", "--storage-driver", "vfs", *places]

    def make_base(self, distribution: str, folder: Path) -> None:
        """Make an image of a minimal Debian."""
        folder.mkdir()
        root = f"{folder}/root"
        run_streamed(["debootstrap", "--variant=minbase", distribution, root], _ignore)
        run_streamed(["tar", "-C", root, "-cf", f"{folder}/root.tar", "."], _ignore)
        shutil.rmtree(root)
        (folder / "Dockerfile").write_text("FROM scratch\nADD root.tar /\n")
        self.build(_BASE, folder)

    def build(self, image: str, context: Path, *options: str) -> None:
        """Build an image from a folder with a Dockerfile."""
        build = ("build", "--isolation=chroot", f"--tag={image}", *options, str(context))
        run_streamed([*self._command, *build], _ignore)

    def run(self, *program: str) -> str:
        """Return what a program prints in a new container."""
        container = self._ask("from", "--pull-never", _IMAGE)
        return self._ask("run", "--isolation=chroot", container, "--", *program)

    def _ask(self, *arguments: str) -> str:
        command = [*self._command, *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        return (done.stdout or done.stderr).strip()

    def remove(self) -> None:
        """Remove containers and images, and unmount what an interrupted build left mounted."""
        self._ask("rm", "--all")
        self._ask("rmi", "--all", "--force")
        for line in reversed(Path("/proc/self/mounts").read_text().splitlines()):
            point = Path(line.split()[1])
            if point.is_relative_to(self._folder.resolve()):
                subprocess.run(["umount", "--lazy", str(point)], capture_output=True, check=False)


def _ignore(_: str) -> None:
    """Ignore a line of a program; its last lines are part of the error."""
