"""Transports to a machine, this one or another over SSH, and a copy of what detection reads there.

The same shell commands run on both. The machine needs `sh` and `tar`, and over SSH a key without a passphrase
prompt and a user with `sudo` without password.
"""

from __future__ import annotations

import base64
import shlex
import socket
import subprocess
import tempfile
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.bases import JETPACK
from sfglab.deploy.errors import DeployError
from sfglab.deploy.hardware import detect
from sfglab.deploy.programs import run_heard
from sfglab.fleet.fleet_file import Accelerator, HostSpec

if TYPE_CHECKING:
    from collections.abc import Callable

CONNECT_S = 10  #: Time limit for an SSH connection.
QUICK_S = 120.0  #: Time limit for a command that only moves files.


class Transport(ABC):
    """A machine that takes commands."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the machine in messages."""

    @property
    def root(self) -> str:
        """Folder in place of its root; empty if there is none."""
        return ""

    @abstractmethod
    def command(self, script: str) -> list[str]:
        """Return the program that runs a script of `sh` there as root."""

    def run(self, script: str, *, data: bytes = b"", timeout_s: float = QUICK_S) -> bytes:
        """Run a script of `sh` there as root, with `data` as its standard input; return what it prints.

        Raises `DeployError` if it cannot be reached, or the script failed; with its last words.
        """
        command = self.command(script)
        try:
            done = subprocess.run(
                command, input=data, capture_output=True, timeout=timeout_s, check=False
            )
        except FileNotFoundError as error:
            given = f"given the program {command[0]!r}"
            raise DeployError(f"{self.name}: {given}, which is not installed here") from error
        except subprocess.TimeoutExpired as error:
            raise DeployError(f"{self.name}: no answer within {timeout_s:.0f} s") from error
        if done.returncode:
            words = done.stderr.decode(errors="replace").strip().splitlines() or ["without a word"]
            raise DeployError(
                f"{self.name}: {command[0]} ended with status {done.returncode}: {words[-1]}"
            )
        return done.stdout

    def stream(self, script: str, hear: Callable[[str], None]) -> None:
        """Run a script of `sh` there as root, however long it takes, and hand on each line that it prints.

        Raises:
            DeployError: It cannot be reached, or the script failed; with its last words.
        """
        run_heard(self.command(script), hear, self.name)


@dataclass(frozen=True, kw_only=True)
class Local(Transport):
    """This machine."""

    folder: Path = Path("/")  #: Folder in place of its root; ``/`` is the machine itself.

    @property
    def name(self) -> str:
        """Name of the machine in messages."""
        return "this machine" if not self.root else str(self.folder)

    @property
    def root(self) -> str:
        """Folder in place of its root; empty for the machine itself."""
        return "" if self.folder == Path("/") else str(self.folder.absolute())

    def command(self, script: str) -> list[str]:
        """Return the shell with the script."""
        return ["sh", "-eu", "-c", script]


@dataclass(frozen=True, kw_only=True)
class Ssh(Transport):
    """Another machine."""

    address: str  #: ``[user@]host``.
    program: str = "ssh"  #: The SSH client.

    @property
    def name(self) -> str:
        """Name of the machine in messages."""
        return self.address

    def command(self, script: str) -> list[str]:
        """Return the SSH client with the script for the shell at the other end."""
        options = ("-o", "BatchMode=yes", "-o", f"ConnectTimeout={CONNECT_S}")
        return [
            self.program,
            *options,
            "--",
            self.address,
            f"sudo -n sh -eu -c {shlex.quote(script)}",
        ]


def transport_to(host: HostSpec, *, root: Path | None = None) -> Transport:
    """Return the way to a machine, or to a folder of this machine that stands for its root."""
    if root is not None:
        return Local(folder=root)
    return Local() if is_here(host.address) else Ssh(address=host.address)


def is_here(address: str) -> bool:
    """Tell whether an address is this machine's: empty, loopback, or its own name."""
    host = address.rpartition("@")[2].lower()
    own = socket.gethostname().lower()
    return host in {"", "localhost", "127.0.0.1", "::1", own, f"{own}.local", own.partition(".")[0]}


NODES = (
    "/.dockerenv /dev/dri/* /dev/dxg /dev/kfd /dev/nvgpu/*/* /dev/nvhost-* /dev/nvidia* /dev/nvmap "
    "/dev/v4l2-nv* /dev/video* /run/.containerenv /usr/lib/wsl/lib/libcuda.so*"
)
"""Paths whose existence detection checks, as patterns of a shell."""

FILES = (
    "/bin/sh /etc/group /etc/nv_tegra_release /etc/os-release /proc/device-tree/compatible "
    "/proc/device-tree/model /proc/driver/nvidia/version "
    "/sys/class/dmi/id/product_name /sys/class/dmi/id/sys_vendor "
    "/sys/class/drm/renderD*/device/vendor /sys/class/kfd/kfd/topology/nodes/*/properties "
    "/sys/class/video4linux/*/name /sys/firmware/devicetree/base/compatible "
    "/sys/firmware/devicetree/base/model /usr/lib/os-release"
)
"""Files that detection reads."""

_HEAD_BYTES = 65536


def detect_over(host: HostSpec, *, root: Path | None = None) -> Accelerator | None:
    """Return what images for a machine are made for, as `transport_to` and `accelerator_of` say."""
    return accelerator_of(transport_to(host, root=root))


def accelerator_of(transport: Transport) -> Accelerator:
    """Return what images for a machine are made for.

    Raises `DeployError` if it cannot be reached, or is a Jetson with another JetPack than the images' base.
    """
    if isinstance(transport, Local):
        machine = detect(transport.folder)
    else:
        with tempfile.TemporaryDirectory(prefix="sfglab-facts-") as folder:
            copy_facts(transport, Path(folder))
            machine = detect(Path(folder))
    if machine.accelerator is Accelerator.JETSON and machine.jetpack != JETPACK:
        raise DeployError(
            f"{transport.name}: given JetPack {machine.jetpack or 'unknown'}, allowed: {JETPACK}, as in "
            "the images' base"
        )
    return machine.accelerator


def copy_facts(transport: Transport, folder: Path) -> None:
    """Copy what detection reads, nodes as empty files, into a folder; `DeployError` if there is no answer."""
    root = transport.root
    nodes, files = (" ".join(root + path for path in paths.split()) for paths in (NODES, FILES))
    script = (
        f'for p in {nodes}; do if [ -e "$p" ]; then echo "$p"; fi; done\n'
        f'for p in {files}; do if [ -f "$p" ]; then\n'
        f'  echo "$p $(head -c {_HEAD_BYTES} "$p" 2>/dev/null | base64 | tr -d "\\n")"\nfi; done\n'
    )
    for line in transport.run(script).decode(errors="replace").splitlines():
        path, _, content = line.removeprefix(root).partition(" ")
        try:
            target = (folder / path.lstrip("/")).resolve()
            target.relative_to(folder.resolve())
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(base64.b64decode(content))
        except (
            OSError,
            ValueError,
        ) as error:  # not below the root, a folder where a file is, not base64
            given = f"given {path[:80]!r} among what it has ({error})"
            raise DeployError(
                f"{transport.name}: {given}, allowed: files below the machine's root"
            ) from error
