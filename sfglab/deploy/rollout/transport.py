"""Reaching a machine: this one, or another over SSH. The same shell commands run on both.

Knows how bytes and commands get there; refuses to know what they mean. Needs `sh` and `tar` there, and over SSH
a key that asks for nothing and a user who may use `sudo` without a password.
"""

from __future__ import annotations

import shlex
import socket
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from sfglab.deploy.errors import DeployError
from sfglab.deploy.programs import run_heard

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sfglab.fleet.fleet_file import HostSpec


CONNECT_S = 10
"""How long an SSH connection may take."""
QUICK_S = 120.0
"""How long a command that only moves files may take."""


class Transport(Protocol):
    """A machine that takes commands."""

    @property
    def name(self) -> str:
        """What the machine is called in messages."""

    @property
    def root(self) -> str:
        """Where its files begin: empty, or a folder that stands for its root."""

    def run(self, script: str, *, data: bytes = b"", timeout_s: float = QUICK_S) -> bytes:
        """Run a shell script there as root and return what it prints.

        Args:
            script: For `sh`.
            data: Its standard input.
            timeout_s: When it is given up.

        Raises:
            DeployError: It cannot be reached, or the script failed; with its last words.
        """

    def stream(self, script: str, hear: Callable[[str], None]) -> None:
        """Run a shell script there as root, however long it takes, and hand on each line that it prints.

        Args:
            script: For `sh`.
            hear: Told each line.

        Raises:
            DeployError: It cannot be reached, or the script failed; with its last words.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class Local:
    """This machine."""

    folder: Path = Path("/")  #: What stands for its root; ``/`` is the machine itself.

    @property
    def name(self) -> str:
        """What the machine is called in messages."""
        return "this machine" if not self.root else str(self.folder)

    @property
    def root(self) -> str:
        """Where its files begin."""
        return "" if self.folder == Path("/") else str(self.folder.absolute())

    def run(self, script: str, *, data: bytes = b"", timeout_s: float = QUICK_S) -> bytes:
        """Run a shell script here and return what it prints; see `Transport`."""
        return _call(self.name, self._command(script), data, timeout_s)

    def stream(self, script: str, hear: Callable[[str], None]) -> None:
        """Run a shell script here and hand on its lines; see `Transport`."""
        run_heard(self._command(script), hear, self.name)

    def _command(self, script: str) -> list[str]:
        return ["sh", "-eu", "-c", script]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ssh:
    """Another machine."""

    address: str  #: ``[user@]host``.
    program: str = "ssh"  #: The SSH client.

    @property
    def name(self) -> str:
        """What the machine is called in messages."""
        return self.address

    @property
    def root(self) -> str:
        """Where its files begin."""
        return ""

    def run(self, script: str, *, data: bytes = b"", timeout_s: float = QUICK_S) -> bytes:
        """Run a shell script there and return what it prints; see `Transport`."""
        return _call(self.name, self._command(script), data, timeout_s)

    def stream(self, script: str, hear: Callable[[str], None]) -> None:
        """Run a shell script there and hand on its lines; see `Transport`."""
        run_heard(self._command(script), hear, self.name)

    def _command(self, script: str) -> list[str]:
        options = ("-o", "BatchMode=yes", "-o", f"ConnectTimeout={CONNECT_S}")
        return [self.program, *options, "--", self.address, f"sudo -n sh -eu -c {shlex.quote(script)}"]


def transport_to(host: HostSpec, *, root: Path | None = None) -> Transport:
    """Return the way to a machine.

    Args:
        host: The machine.
        root: A folder of this machine that stands for its root; None: the machine itself.
    """
    if root is not None:
        return Local(folder=root)
    return Local() if is_here(host.address) else Ssh(address=host.address)


def is_here(address: str) -> bool:
    """Tell whether an address is this machine's: empty, loopback, or its own name."""
    host = address.rpartition("@")[2].lower()
    own = socket.gethostname().lower()
    return host in {"", "localhost", "127.0.0.1", "::1", own, f"{own}.local", own.partition(".")[0]}


def _call(where: str, command: Sequence[str], data: bytes, timeout_s: float) -> bytes:
    try:
        done = subprocess.run(command, input=data, capture_output=True, timeout=timeout_s, check=False)
    except FileNotFoundError as error:
        raise DeployError(f"{where}: given the program {command[0]!r}, which is not installed here") from error
    except subprocess.TimeoutExpired as error:
        raise DeployError(f"{where}: no answer within {timeout_s:.0f} s") from error
    if done.returncode:
        words = done.stderr.decode(errors="replace").strip().splitlines()
        last = words[-1] if words else "without a word"
        raise DeployError(f"{where}: {command[0]} ended with status {done.returncode}: {last}")
    return done.stdout
