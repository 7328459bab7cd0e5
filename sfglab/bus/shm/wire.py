"""Protocol between a shared-memory publisher and its subscribers: sockets, datagrams and memory files.

All numbers are little-endian; each datagram is one SOCK_SEQPACKET message. Sockets have abstract names, which
belong to a network namespace and disappear with their process.

```text
subscriber -> publisher   HELLO    magic, version, flags, depth           once, first
publisher  -> subscriber  WELCOME  magic, version, gid  + the memory file once, answer to HELLO
publisher  -> subscriber  ANNOUNCE sequence, offset, size, source stamp   per message
subscriber -> publisher   RETURN   offset, offset, ...                    when released, a few at a time
```
"""

from __future__ import annotations

import fcntl
import mmap
import os
import socket
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sfglab.bus.errors import BusError

if TYPE_CHECKING:
    from collections.abc import Sequence

PAGE_BYTES = 4096
#: Size of the first page, bytes; it holds the latest sequence number as one aligned 64-bit word.
HEADER_BYTES = PAGE_BYTES
#: Offset of the CDR in a slot, bytes: the data behind its 4-byte header is aligned to 64 bytes.
DATA_OFFSET_BYTES = 60

_MAGIC = b"sfgs"
_VERSION = 1
_HELLO = struct.Struct("<4sHHI")
_WELCOME = struct.Struct("<4sHH16s")
_ANNOUNCE = struct.Struct("<QQQq")
_RETURNS = tuple(struct.Struct(f"<{count}Q") for count in range(9))
RETURN_MAX = len(_RETURNS) - 1  #: Largest number of slots in one RETURN.
_PREFIX = _MAGIC + struct.pack("<H", _VERSION)
_FLAG_HISTORY = 1
HELLO_BYTES = _HELLO.size
ANNOUNCE_BYTES = _ANNOUNCE.size
RETURN_BYTES = _RETURNS[-1].size

_UCRED = struct.Struct("3i")  # pid, uid, gid (unix(7), SO_PEERCRED)
_BACKLOG = 128


class ProtocolError(BusError, ValueError):
    """A peer sent a datagram that no peer of this version sends."""

    def __init__(self, datagram: bytes, expected: str) -> None:
        super().__init__(
            f"shared memory: given {datagram.hex() or 'nothing'}, expected: {expected}"
        )


class Hello(NamedTuple):
    """Content of a HELLO, the first datagram that a subscriber sends to a publisher."""

    depth: int  #: Number of the newest messages to keep for the subscriber; 0 for all.
    wants_history: bool  #: Whether the subscriber requests messages published before it connected.


class Announcement(NamedTuple):
    """Position of a message in the memory file."""

    sequence: int  #: Sequence number from 1, for each publisher.
    offset: int  #: Offset of the slot in the memory file, bytes.
    size: int  #: Size of the CDR, bytes.
    source_timestamp_ns: int  #: Time of publication, Unix time, ns.


def pack_hello(hello: Hello) -> bytes:
    """Return the HELLO datagram with this content."""
    return _HELLO.pack(_MAGIC, _VERSION, _FLAG_HISTORY * hello.wants_history, hello.depth)


def unpack_hello(datagram: bytes) -> Hello:
    """Return the content of a HELLO.

    Raises:
        ProtocolError: The datagram is no HELLO.
    """
    if len(datagram) != _HELLO.size or not datagram.startswith(_PREFIX):
        raise ProtocolError(datagram, f"a hello of version {_VERSION}")
    _, _, flags, depth = _HELLO.unpack(datagram)
    return Hello(depth, bool(flags & _FLAG_HISTORY))


def pack_welcome(gid: bytes) -> bytes:
    """Return a WELCOME with the GUID of the writer that announces the publisher."""
    return _WELCOME.pack(_MAGIC, _VERSION, 0, gid)


def unpack_welcome(datagram: bytes) -> bytes:
    """Return the GUID in a WELCOME.

    Raises:
        ProtocolError: The datagram is no WELCOME.
    """
    if len(datagram) != _WELCOME.size or not datagram.startswith(_PREFIX):
        raise ProtocolError(datagram, f"a welcome of version {_VERSION}")
    gid: bytes = _WELCOME.unpack(datagram)[3]
    return gid


def pack_announcement(announcement: Announcement) -> bytes:
    """Return the ANNOUNCE datagram for one message."""
    return _ANNOUNCE.pack(*announcement)


def unpack_announcement(datagram: bytes, arena_bytes: int) -> tuple[int, int, int, int]:
    """Return the content of an ANNOUNCE, in the order of `Announcement`; its slot is inside the memory file.

    Raises:
        ProtocolError: The datagram is no ANNOUNCE, or its slot is outside the memory file.
    """
    if len(datagram) != _ANNOUNCE.size:
        raise ProtocolError(datagram, f"an announcement of {_ANNOUNCE.size} bytes")
    announcement: tuple[int, int, int, int] = _ANNOUNCE.unpack(datagram)
    _, start, size, _ = announcement
    end = start + DATA_OFFSET_BYTES + size
    if start % PAGE_BYTES or start < HEADER_BYTES or end > arena_bytes:
        raise ProtocolError(datagram, f"a slot inside the {arena_bytes} bytes of the memory file")
    return announcement


def pack_returns(offsets: Sequence[int]) -> bytes:
    """Return a RETURN of 1 to `RETURN_MAX` slots."""
    return _RETURNS[len(offsets)].pack(*offsets)


def unpack_returns(datagram: bytes) -> tuple[int, ...]:
    """Return the offsets in a RETURN.

    Raises:
        ProtocolError: The datagram is no RETURN.
    """
    count, rest = divmod(len(datagram), 8)
    if rest or not 1 <= count <= RETURN_MAX:
        raise ProtocolError(datagram, f"a return of 8 to {RETURN_BYTES} bytes")
    return _RETURNS[count].unpack(datagram)


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
        OSError: No socket listens at this name, or not any more.
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


# --- Memory files ---------------------------------------------------------------------------------------------

# linux/fcntl.h; the fcntl module lacks these in some builds.
_F_ADD_SEALS, _F_GET_SEALS = 1033, 1034
_F_SEAL_SEAL, _F_SEAL_SHRINK, _F_SEAL_GROW = 1, 2, 4


class OwnArena:
    """Memory file of fixed, sparse size; sealed against shrinking, so that no reader receives SIGBUS."""

    def __init__(self, size_bytes: int, name: str) -> None:
        self.size_bytes = size_bytes
        self._fd = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.ftruncate(self._fd, size_bytes)
            fcntl.fcntl(self._fd, _F_ADD_SEALS, _F_SEAL_SHRINK | _F_SEAL_GROW | _F_SEAL_SEAL)
            # The file is opened again because a passed descriptor keeps the access mode of its opening.
            self.reader_fd = os.open(f"/proc/self/fd/{self._fd}", os.O_RDONLY | os.O_CLOEXEC)
            self._map = mmap.mmap(self._fd, size_bytes)
        except BaseException:
            os.close(self._fd)
            raise
        self._latest = np.frombuffer(self._map, np.uint64, 1)
        self._bytes = memoryview(self._map)

    def reserve(self, offset: int, size: int) -> None:
        """Allocate memory for a new slot now, because an error is better than a fault while writing.

        Raises:
            OSError: The host or the container does not have enough memory.
        """
        os.posix_fallocate(self._fd, offset, size)

    def view(self, offset: int, size: int) -> memoryview:
        """Return the writable memory of `size` bytes of CDR in the slot at `offset`."""
        start = offset + DATA_OFFSET_BYTES
        return self._bytes[start : start + size]

    def set_latest(self, sequence: int) -> None:
        """Show every subscriber, without a system call, the sequence number of the newest message."""
        self._latest[0] = sequence

    def close(self) -> None:
        """Free the memory that no subscriber maps; lent views stay valid."""
        os.close(self.reader_fd)
        os.close(self._fd)
        del self._latest, self._bytes, self._map


class ArenaMap:
    """Read-only map of a publisher's memory file at a subscriber; it keeps a descriptor of its own.

    Raises:
        BusError: A peer could truncate the file, or the file is too small to be an arena.
    """

    def __init__(self, fd: int) -> None:
        self.size_bytes = os.fstat(fd).st_size
        seals = fcntl.fcntl(fd, _F_GET_SEALS)
        if not seals & _F_SEAL_SHRINK or self.size_bytes < HEADER_BYTES:
            raise BusError(
                "shared memory: the received file is no sealed memory file of a publisher"
            )
        memory = mmap.mmap(fd, self.size_bytes, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ)
        self._all: Any = np.frombuffer(memory, np.uint8)
        #: One item: the newest sequence number, which the publisher keeps up to date.
        self.latest = memoryview(memory)[:8].cast("Q")

    def slice(self, offset: int, size: int) -> Any:
        """Return the read-only bytes of a message as an array that all views of it keep alive."""
        start = offset + DATA_OFFSET_BYTES
        return self._all[start : start + size]
