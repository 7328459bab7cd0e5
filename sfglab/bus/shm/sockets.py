"""Unix sockets in the abstract namespace: per network namespace, and gone with their process."""

from __future__ import annotations

import os
import secrets
import socket
import struct

_UCRED = struct.Struct("3i")  # pid, uid, gid (unix(7), SO_PEERCRED)
_BACKLOG = 128


def address(domain_id: int) -> str:
    """Return a new socket name."""
    return f"sfglab/{domain_id}/{secrets.token_hex(8)}"


def listen(name: str) -> socket.socket:
    """Return a listening, non-blocking socket with an abstract name."""
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
    try:
        sock.bind("\0" + name)
        sock.listen(_BACKLOG)
    except BaseException:
        sock.close()
        raise
    return sock


def connect(name: str) -> socket.socket:
    """Return a non-blocking socket that is connected to an abstract name.

    Raises:
        OSError: Nobody listens there (any more).
    """
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
    try:
        sock.connect("\0" + name)
    except BaseException:
        sock.close()
        raise
    return sock


def same_user(sock: socket.socket) -> bool:
    """Return whether the peer runs as the same user as this process, or as root."""
    _, uid, _ = _UCRED.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size))
    return uid in {os.geteuid(), 0}
