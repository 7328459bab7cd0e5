"""One router for each pair of domains on a host: a lock that nobody has to clean up.

An abstract Unix socket belongs to the network namespace, as do the domains' ports, and the kernel frees it with
the process that holds it, however that one ends.
"""

from __future__ import annotations

import errno
import socket
import struct
from typing import Self

from sfglab.errors import SfglabError

_PEER = struct.Struct("3i")  # struct ucred: pid, uid, gid


class RouterRunningError(SfglabError, RuntimeError):
    """Another router serves the pair of domains on this host.

    Attributes:
        domains: The two domain ids, sorted.
        pid: The other's process id; None when it cannot be seen from here.
    """

    def __init__(self, domains: tuple[int, int], pid: int | None) -> None:
        self.domains = domains
        self.pid = pid
        who = "a process out of sight" if pid is None else f"process {pid}"
        super().__init__(
            f"router between the domains {domains[0]} and {domains[1]}: {who} on this host is one already, "
            "allowed is one, because two would send everything twice; end the other first"
        )


class PairLock:
    """Held while a router serves a pair of domains; a context manager.

    Args:
        one: A domain id.
        other: The other one.
    """

    def __init__(self, one: int, other: int) -> None:
        self._domains = (min(one, other), max(one, other))
        self._socket: socket.socket | None = None

    def __enter__(self) -> Self:
        self._socket = _bound(self._domains)
        return self

    def __exit__(self, *_: object) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _address(domains: tuple[int, int]) -> str:
    return f"\0sfglab.router.{domains[0]}-{domains[1]}"


def _bound(domains: tuple[int, int]) -> socket.socket:
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        lock.bind(_address(domains))
        lock.listen()  # so that whoever comes second can ask who we are
    except OSError as error:
        lock.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise RouterRunningError(domains, _holder(domains)) from error
    return lock


def _holder(domains: tuple[int, int]) -> int | None:
    """Return who listens; None when that one just left, is asked by too many, or lives in another PID space."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(_address(domains))
            credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
        except OSError:
            return None
    pid: int = _PEER.unpack(credentials)[0]
    return pid or None
