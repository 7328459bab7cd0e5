"""Transports to a target host, this one or another one over SSH, and a copy of the files that detection reads.

The same shell commands run on both. A host needs `sh` and `tar`; a host over SSH also needs a key without a
passphrase prompt, and a user with `sudo` without password.
"""

from __future__ import annotations

import base64
import shlex
import socket
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.bases import JETPACK
from sfglab.deploy.errors import DeployError
from sfglab.deploy.hardware import detect
from sfglab.deploy.programs import run_streamed
from sfglab.fleet.fleet_file import AUTO, Accelerator, HostSpec

if TYPE_CHECKING:
    from collections.abc import Callable

CONNECT_S = 10  #: Time limit for an SSH connection.
QUICK_S = 120.0  #: Time limit for a command that only moves files.


@dataclass(frozen=True, slots=True, kw_only=True)
class Transport:
    """Access to a host that runs commands: another host over SSH, this host, or a folder of this host."""

    address: str = ""  #: ``[user@]host`` of another machine; empty for this one.
    folder: Path = Path("/")  #: Folder of this machine that stands for the host's root.
    client: str = "ssh"  #: SSH client.

    @property
    def name(self) -> str:
        """Name of the machine in messages."""
        return self.address or self.root or "this machine"

    @property
    def root(self) -> str:
        """Folder that stands for the host's root; empty for a real root."""
        return "" if self.folder == Path("/") else str(self.folder.absolute())

    def command(self, script: str) -> list[str]:
        """Return the command line that runs a script of `sh` on the host as root."""
        if not self.address:
            return ["sh", "-eu", "-c", script]
        options = ("-o", "BatchMode=yes", "-o", f"ConnectTimeout={CONNECT_S}")
        remote = f"sudo -n sh -eu -c {shlex.quote(script)}"
        return [self.client, *options, "--", self.address, remote]

    def run(self, script: str, *, data: bytes = b"", timeout_s: float = QUICK_S) -> bytes:
        """Run a script of `sh` on the host as root, and return its standard output.

        Args:
            script: The script.
            data: Standard input of the script.
            timeout_s: Time limit, s.

        Raises:
            DeployError: The host cannot be reached, or the script failed; the error has the last line of the output.
        """
        command = self.command(script)
        try:
            done = subprocess.run(
                command, input=data, capture_output=True, timeout=timeout_s, check=False
            )
        except FileNotFoundError as error:
            raise DeployError(
                f"{self.name}: {command[0]} is not installed on this computer; install it"
            ) from error
        except subprocess.TimeoutExpired as error:
            raise DeployError(
                f"{self.name}: no answer within {timeout_s:.0f} s; check that the host is on and reachable"
            ) from error
        if done.returncode:
            lines = done.stderr.decode(errors="replace").strip().splitlines() or ["no message"]
            raise DeployError(
                f"{self.name}: {command[0]} ended with status {done.returncode} ({lines[-1]}); correct the cause and run the command again"
            )
        return done.stdout

    def stream(self, script: str, on_line: Callable[[str], None]) -> None:
        """Run a script of `sh` on the host as root without time limit; call `on_line` with each line of its output.

        Raises:
            DeployError: The host cannot be reached, or the script failed; the error has the last lines of the output.
        """
        run_streamed(self.command(script), on_line, self.name)


def transport_to(host: HostSpec, *, root: Path | None = None) -> Transport:
    """Return the transport to a machine, or to a folder of this machine that stands for its root."""
    if root is not None:
        return Transport(folder=root)
    return Transport() if is_here(host.address) else Transport(address=host.address)


def is_here(address: str) -> bool:
    """Return whether an address is this machine's: empty, loopback, or its own name."""
    host = address.rpartition("@")[2].lower()
    own = socket.gethostname().lower()
    return host in {"", "localhost", "127.0.0.1", "::1", own, f"{own}.local", own.partition(".")[0]}


NODES = (
    "/.dockerenv /dev/dri/* /dev/dxg /dev/kfd /dev/nvgpu/*/* /dev/nvhost-* /dev/nvidia* /dev/nvmap "
    "/dev/v4l2-nv* /dev/video* /run/.containerenv /usr/lib/wsl/lib/libcuda.so*"
)
"""Paths whose existence detection checks, as patterns of a shell."""

FILES = (
    "/etc/nv_tegra_release /etc/os-release /proc/device-tree/compatible "
    "/proc/device-tree/model /proc/driver/nvidia/version "
    "/sys/class/drm/renderD*/device/vendor /sys/class/kfd/kfd/topology/nodes/*/properties "
    "/sys/class/video4linux/*/name /sys/firmware/devicetree/base/compatible "
    "/sys/firmware/devicetree/base/model /usr/lib/os-release"
)
"""Files that detection reads."""

_HEAD_BYTES = 65536


def chooser(
    name: str | None = None, root: Path | None = None
) -> Callable[[HostSpec], Accelerator | None]:
    """Return a function that returns the accelerator of a machine.

    Args:
        name: Accelerator of all machines, or ``auto`` to detect it; None for that of the fleet file, or if
            it is ``auto``, to detect it.
        root: Folder in place of the machine's root.
    """
    is_named = name not in {None, AUTO}

    def choose(host: HostSpec) -> Accelerator:
        accelerator = host.accelerator if name is None else None
        if is_named:
            accelerator = Accelerator(name)
        return accelerator or accelerator_of(transport_to(host, root=root))

    return choose


def accelerator_of(transport: Transport) -> Accelerator:
    """Return the accelerator that images for a machine are made for.

    Raises:
        DeployError: The machine cannot be reached, or is a Jetson with another JetPack than the base image.
    """
    if transport.address:
        with tempfile.TemporaryDirectory(prefix="sfglab-facts-") as folder:
            copy_facts(transport, Path(folder))
            machine = detect(Path(folder))
    else:
        machine = detect(transport.folder)
    if machine.accelerator is Accelerator.JETSON and machine.jetpack != JETPACK:
        raise DeployError(
            f"{transport.name}: given JetPack {machine.jetpack or 'unknown'}, allowed: {JETPACK}, the "
            "version of the base images"
        )
    return machine.accelerator


def copy_facts(transport: Transport, folder: Path) -> None:
    """Copy the files that detection reads from a host into a folder; device nodes become empty files.

    Raises:
        DeployError: The machine cannot be reached, or names files outside of its root.
    """
    script = (
        f'for p in {NODES}; do if [ -e "$p" ]; then echo "$p"; fi; done\n'
        f'for p in {FILES}; do if [ -f "$p" ]; then\n'
        f'  echo "$p $(head -c {_HEAD_BYTES} "$p" 2>/dev/null | base64 | tr -d "\\n")"\nfi; done\n'
    )
    inside = folder.resolve()
    for line in transport.run(script).decode(errors="replace").splitlines():
        path, _, content = line.partition(" ")
        try:
            target = (folder / path.lstrip("/")).resolve()
            target.relative_to(inside)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(base64.b64decode(content))
        except (
            OSError,
            ValueError,
        ) as error:  # outside, a folder in the place of a file, not base64
            raise DeployError(
                f"{transport.name}: given {path[:80]!r} ({error}), allowed: files below its root"
            ) from error
