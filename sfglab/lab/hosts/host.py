"""A test host: its errors, its address, and its processes, which see only its network and end with it.

A namespace of a test host contains only processes that were started inside, and their descendants, daemons
included. Therefore membership identifies all processes to end. Signals go through pidfds (pidfd_open(2)), whose
membership is checked after opening. A later process with the same pid therefore never receives a signal.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

_REMEDY = (
    "Try one of: run as root; allow user namespaces (sysctl user.max_user_namespaces and max_net_namespaces "
    "above 0, which 'No space left' is about, and on Debian and Ubuntu kernel.unprivileged_userns_clone=1 and "
    "kernel.apparmor_restrict_unprivileged_userns=0); in a container, start it with --cap-add=SYS_ADMIN "
    "--cap-add=NET_ADMIN and a seccomp profile that allows unshare"
)


class HostsUnavailableError(SfglabError, OSError):
    """Error of a machine that cannot make network namespaces."""

    def __init__(self, reason: str) -> None:
        self.reason = reason  #: Error of the kernel or of the starting process.
        super().__init__(
            f"test hosts need network namespaces, which failed here: {reason}. {_REMEDY}"
        )


class HostsError(SfglabError, RuntimeError):
    """A network of test hosts is closed, lost its hub, or failed to execute a request."""


# A killed process is gone within milliseconds, unless a device driver blocks it.
_KILL_TIMEOUT_S = 5.0


def _inode(pid: int) -> int:
    """Return the inode of a process's network namespace; 0 if it ended or is not visible to this process."""
    try:
        return os.stat(f"/proc/{pid}/ns/net").st_ino  # noqa: PTH116 - called for every process
    except OSError:
        return 0


def members(inodes: Collection[int]) -> list[int]:
    """Return the pids of all processes, except the calling one, in network namespaces of some inodes."""
    pids = (int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit())
    return [pid for pid in pids if pid != os.getpid() and _inode(pid) in inodes]


@contextlib.contextmanager
def _handles(inodes: Collection[int]) -> Iterator[dict[int, int]]:
    """Open a pidfd for each member, and close all at the end; pids by pidfd."""
    handles: dict[int, int] = {}
    try:
        for pid in members(inodes):
            with contextlib.suppress(ProcessLookupError):
                fd = os.pidfd_open(pid)
                handles[fd] = pid
                if _inode(pid) not in inodes:
                    os.close(fd)
                    del handles[fd]
        yield handles
    finally:
        for fd in handles:
            os.close(fd)


def _wait(handles: Collection[int], deadline_s: float) -> None:
    """Wait until all processes have ended, at most until the deadline."""
    poll = select.poll()
    for fd in handles:
        poll.register(fd, select.POLLIN)
    left = len(handles)
    while left and (rest_s := deadline_s - time.monotonic()) > 0:
        for fd, _ in poll.poll(rest_s * 1000):
            poll.unregister(fd)
            left -= 1


def _signal_all(inodes: Collection[int], number: int, deadline_s: float) -> list[int]:
    """Signal all members, wait for their end, and return their pids."""
    with _handles(inodes) as handles:
        for fd in handles:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(fd, number)
        _wait(handles, deadline_s)
        return list(handles.values())


def end_members(inodes: Collection[int], *, grace_s: float) -> None:
    """End all processes in network namespaces: with SIGTERM and, after a grace period, with SIGKILL.

    Args:
        inodes: Inodes of the network namespaces.
        grace_s: Grace period, s.

    Raises:
        HostsError: A process is still there.
    """
    if grace_s > 0:
        _signal_all(inodes, signal.SIGTERM, time.monotonic() + grace_s)
    deadline_s = time.monotonic() + _KILL_TIMEOUT_S
    while stubborn := _signal_all(inodes, signal.SIGKILL, deadline_s):
        if time.monotonic() > deadline_s:
            raise HostsError(f"processes {stubborn} inside test hosts were killed but did not end")


INTERFACE = "eth0"

ENTER = (sys.executable, "-I", "-S", str(Path(__file__).with_name("enter.py")))
"""Command line of the script that makes or joins namespaces; without the site module it starts in about 15
ms."""


class InterfaceBytes(NamedTuple):
    """Bytes and packets of an interface since its creation: Ethernet frames without their checksums."""

    rx_bytes: int
    rx_packets: int
    tx_packets: int


def interface_bytes(table: str, interface: str) -> InterfaceBytes:
    """Return the byte counters of an interface from the text of ``/proc/net/dev`` (proc(5)).

    Raises:
        LookupError: The interface is not listed.
    """
    for line in table.splitlines():
        name, _, numbers = line.partition(":")
        if name.strip() == interface:
            fields = [int(number) for number in numbers.split()]
            return InterfaceBytes(fields[0], fields[1], fields[9])
    raise LookupError(f"interface {interface!r} is not in /proc/net/dev")


class Host:
    """A host of a `Network`, made by `Network.add_host`.

    Hosts share the machine's file system, `/dev/shm`, processes and clock; only their network is their own.

    Raises:
        HostsError: The network is closed or lost. All methods that run or read something raise it.
    """

    interface = INTERFACE  #: Name of the host's interface to the network.

    def __init__(self, name: str, *, address: str, holder: int, how: str) -> None:
        self.name = name  #: Name of the host in the network.
        self.address = address  #: IPv4 address of the host.
        self._holder = holder
        self._how = how
        # The open descriptor keeps the namespace, and with it the inode, unique.
        self._namespace = os.open(f"/proc/{holder}/ns/net", os.O_RDONLY)
        #: Inode of its network namespace.
        self.inode = os.fstat(self._namespace).st_ino
        self._started: list[subprocess.Popen[Any]] = []
        self._closed = False

    def argv(self, command: Sequence[str | os.PathLike[str]]) -> list[str]:
        """Return a command line that runs a command inside this host.

        The wrapper becomes the command (exec), so pid, signals and pipes are those of the command. Exit
        status 125 means that the host is gone, 126 and 127 that the command cannot be run or was not found.
        """
        if self._closed:
            raise HostsError(
                f"host {self.name!r} is closed: start processes inside the network's `with` block"
            )
        wrapper = [*ENTER, "join", str(self._holder), str(self.inode), self._how]
        return [*wrapper, *(os.fspath(part) for part in command)]

    def popen(
        self, command: Sequence[str | os.PathLike[str]], **options: Any
    ) -> subprocess.Popen[Any]:
        """Start a process inside this host, with options of `subprocess.Popen`; it ends with the network."""
        process = subprocess.Popen(self.argv(command), **options)
        self._started = [p for p in self._started if p.poll() is None]
        self._started.append(process)
        return process

    def run(
        self, command: Sequence[str | os.PathLike[str]], timeout_s: float, **options: Any
    ) -> subprocess.CompletedProcess[Any]:
        """Run a process inside this host, with options of `subprocess.run`; by default its text is captured."""
        options = {"capture_output": True, "text": True, "check": False} | options
        return subprocess.run(self.argv(command), timeout=timeout_s, **options)  # noqa: PLW1510 - given above

    def interface_bytes(self) -> InterfaceBytes:
        """Return the bytes that this host's interface has sent and received so far; it reads one small file.

        Raises:
            HostsError: The network is closed or lost.
        """
        try:
            table = Path(f"/proc/{self._holder}/net/dev").read_text(encoding="ascii")
            return interface_bytes(table, self.interface)
        except (OSError, LookupError) as error:
            raise HostsError(
                f"host {self.name!r}: its interface is gone, so the network is closed"
            ) from error

    def close(self) -> None:
        """End and reap the processes started by `popen`; the network calls it."""
        if self._closed:
            return
        self._closed = True
        for process in self._started:
            if process.poll() is None:
                process.kill()
                process.wait()
        os.close(self._namespace)
