"""One test host: an address, and processes that see only its network."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.lab.hosts.channel import ENTER
from sfglab.lab.hosts.errors import HostsError

if TYPE_CHECKING:
    from collections.abc import Sequence


INTERFACE = "eth0"


class InterfaceBytes(NamedTuple):
    """What an interface has carried since it exists: Ethernet frames, without their checksums."""

    rx_bytes: int
    tx_bytes: int
    rx_packets: int
    tx_packets: int


def interface_bytes(table: str, interface: str) -> InterfaceBytes:
    """Read one interface's counters from the text of ``/proc/net/dev`` (proc(5)).

    Args:
        table: The text.
        interface: Name of the interface.

    Raises:
        LookupError: The text has no such interface.
    """
    for line in table.splitlines():
        name, _, numbers = line.partition(":")
        if name.strip() == interface:
            fields = [int(number) for number in numbers.split()]
            return InterfaceBytes(fields[0], fields[8], fields[1], fields[9])
    raise LookupError(f"interface {interface!r} is not in /proc/net/dev")


class Host:
    """A host of a `Network`, made by `Network.add_host`.

    Hosts share the machine's file system, `/dev/shm`, processes and clock; only their network is their own.

    Attributes:
        name: Its name in the network.
        address: Its IPv4 address.
        interface: Its interface to the network.
    """

    interface = INTERFACE

    def __init__(self, name: str, *, address: str, holder: int, how: str) -> None:
        self.name = name
        self.address = address
        self._holder = holder
        self._how = how
        # Keeps the namespace, and with it the inode, unique as long as we refer to it.
        self._namespace = os.open(f"/proc/{holder}/ns/net", os.O_RDONLY)
        self._inode = os.fstat(self._namespace).st_ino
        self._started: list[subprocess.Popen[Any]] = []
        self._closed = False

    def __repr__(self) -> str:
        return f"Host({self.name!r}, address={self.address!r})"

    @property
    def inode(self) -> int:
        """Return the inode of the host's network namespace, its identity in the kernel."""
        return self._inode

    def argv(self, command: Sequence[str | os.PathLike[str]]) -> list[str]:
        """Wrap a command line so that it runs inside this host.

        The wrapper becomes the command (exec), so pid, signals and pipes are the command's own. Use it with
        whatever starts processes, e.g. ``asyncio.create_subprocess_exec(*host.argv(command))``. Exit status 125
        says that the host is gone, 126 and 127 that the command cannot be run or found.

        Args:
            command: Program and arguments.

        Raises:
            HostsError: The network is closed.
        """
        if self._closed:
            raise HostsError(f"host {self.name!r} is closed: start processes inside the network's `with` block")
        wrapper = [*ENTER, "join", str(self._holder), str(self._inode), self._how]
        return [*wrapper, *(os.fspath(part) for part in command)]

    def popen(self, command: Sequence[str | os.PathLike[str]], **options: Any) -> subprocess.Popen[Any]:
        """Start a process inside this host; it ends with the network at the latest.

        Args:
            command: Program and arguments.
            options: Anything that `subprocess.Popen` takes.

        Raises:
            HostsError: The network is closed.
        """
        process = subprocess.Popen(self.argv(command), **options)
        self._started = [p for p in self._started if p.poll() is None]
        self._started.append(process)
        return process

    def run(
        self, command: Sequence[str | os.PathLike[str]], timeout_s: float, **options: Any
    ) -> subprocess.CompletedProcess[Any]:
        """Run a process inside this host to its end, by default with its output captured as text.

        Args:
            command: Program and arguments.
            timeout_s: Time after which it is killed, in seconds.
            options: Anything that `subprocess.run` takes.

        Raises:
            HostsError: The network is closed.
            subprocess.TimeoutExpired: It took longer.
        """
        options = {"capture_output": True, "text": True, "check": False} | options
        return subprocess.run(self.argv(command), timeout=timeout_s, **options)  # noqa: PLW1510 - given above

    def interface_bytes(self) -> InterfaceBytes:
        """Return what this host's interface has carried so far; costs the reading of one small file.

        Raises:
            HostsError: The network is closed or lost.
        """
        try:
            table = Path(f"/proc/{self._holder}/net/dev").read_text(encoding="ascii")
            return interface_bytes(table, self.interface)
        except (OSError, LookupError) as error:
            raise HostsError(f"host {self.name!r}: its interface is gone, so the network is closed") from error

    def close(self) -> None:
        """Reap the processes started by `popen` once they ended; the network calls it."""
        if self._closed:
            return
        self._closed = True
        for process in self._started:
            if process.poll() is None:
                process.kill()
                process.wait()
        os.close(self._namespace)
