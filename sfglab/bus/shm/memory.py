"""A publisher's memory file: its slots, counted by their users, and a subscriber's read-only map of it."""

from __future__ import annotations

import fcntl
import mmap
import os
from typing import Any

import numpy as np

from sfglab.bus.errors import BusError
from sfglab.bus.shm.wire import DATA_OFFSET_BYTES, HEADER_BYTES, PAGE_BYTES

# Sizes are rounded up to four steps per octave, so at most a fifth of a slot is unused.
_STEPS_PER_OCTAVE = 4


# linux/fcntl.h; the fcntl module lacks these in some builds.
_F_ADD_SEALS, _F_GET_SEALS = 1033, 1034
_F_SEAL_SEAL, _F_SEAL_SHRINK, _F_SEAL_GROW = 1, 2, 4


class SlotPool:
    """Slots in an arena, each counted by its users.

    Args:
        arena_bytes: The arena's size; its first page is not for slots.
    """

    def __init__(self, arena_bytes: int) -> None:
        self.arena_bytes = arena_bytes
        self._end = HEADER_BYTES
        self._free: dict[int, list[int]] = {}  # capacity -> offsets
        self._capacity: dict[int, int] = {}  # offset -> capacity, of every slot ever made
        self._users: dict[int, int] = {}  # offset -> count, of those in use

    @property
    def used_bytes(self) -> int:
        """How much of the arena has ever been used; it never shrinks."""
        return self._end

    @property
    def slots_in_use(self) -> int:
        """How many slots somebody uses."""
        return len(self._users)

    def acquire(self, size: int) -> tuple[int, int] | None:
        """Return a free slot with one user.

        Args:
            size: The length of what shall fit in, in bytes.

        Returns:
            Its offset, and the number of bytes that were added to the arena for it (0 for a used one); None
            when the arena is full.
        """
        capacity = slot_capacity(size)
        if not self._users and self._end + capacity > self.arena_bytes:
            self._forget()
        offset = self._reused(capacity)
        if offset is not None:
            self._users[offset] = 1
            return offset, 0
        if self._end + capacity > self.arena_bytes:
            return None
        offset = self._end
        self._end += capacity
        self._capacity[offset] = capacity
        self._users[offset] = 1
        return offset, capacity

    def retain(self, offset: int) -> None:
        """Count one more user of a slot in use."""
        self._users[offset] += 1

    def release(self, offset: int) -> None:
        """Count one user less; without users the slot is free."""
        self._users[offset] -= 1
        if self._users[offset] == 0:
            del self._users[offset]
            self._free.setdefault(self._capacity[offset], []).append(offset)

    def _forget(self) -> None:
        """Start anew: all slots are free, but the arena is cut into sizes that nobody asks for now."""
        self._end = HEADER_BYTES
        self._free.clear()
        self._capacity.clear()

    def _reused(self, capacity: int) -> int | None:
        """Take a free slot of this capacity; when the arena is full, also a larger one."""
        if self._free.get(capacity):
            return self._free[capacity].pop()
        if self._end + capacity <= self.arena_bytes:
            return None
        larger = min((c for c, offsets in self._free.items() if c > capacity and offsets), default=None)
        return None if larger is None else self._free[larger].pop()


def slot_capacity(size: int) -> int:
    """Return the bytes a slot for `size` bytes of CDR takes: whole pages, four sizes per octave."""
    pages = -(-(size + DATA_OFFSET_BYTES) // PAGE_BYTES)
    step = max(1, (1 << (pages.bit_length() - 1)) // _STEPS_PER_OCTAVE)
    return -(-pages // step) * step * PAGE_BYTES


class OwnArena:
    """An anonymous memory file of fixed, sparse size: memory is only taken where it is written.

    Sealed against shrinking, so that no peer can make another one read behind its end (SIGBUS).

    Args:
        size_bytes: Its size.
        name: What /proc shows.
    """

    def __init__(self, size_bytes: int, name: str) -> None:
        self.size_bytes = size_bytes
        self._fd = os.memfd_create(name, os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        try:
            os.ftruncate(self._fd, size_bytes)
            fcntl.fcntl(self._fd, _F_ADD_SEALS, _F_SEAL_SHRINK | _F_SEAL_GROW | _F_SEAL_SEAL)
            # Opened again, because a descriptor passed on carries the access mode it was opened with.
            self.reader_fd = os.open(f"/proc/self/fd/{self._fd}", os.O_RDONLY | os.O_CLOEXEC)
            self._map = mmap.mmap(self._fd, size_bytes)
        except BaseException:
            os.close(self._fd)
            raise
        self._latest = np.frombuffer(self._map, np.uint64, 1)
        self._bytes = memoryview(self._map)

    def reserve(self, offset: int, size: int) -> None:
        """Take memory for a new slot now, as an error is better than a fault while writing.

        Raises:
            OSError: The host or the container has not so much.
        """
        os.posix_fallocate(self._fd, offset, size)

    def view(self, offset: int, size: int) -> memoryview:
        """Return the writable memory of `size` bytes of CDR in the slot at `offset`."""
        start = offset + DATA_OFFSET_BYTES
        return self._bytes[start : start + size]

    def set_latest(self, sequence: int) -> None:
        """Tell every subscriber, without a system call, which message is the newest."""
        self._latest[0] = sequence

    def close(self) -> None:
        """Give the memory back, as far as no subscriber maps it; views that were lent stay valid."""
        os.close(self.reader_fd)
        os.close(self._fd)
        del self._latest, self._bytes, self._map


class ArenaMap:
    """A subscriber's view of a publisher's memory file.

    Attributes:
        size_bytes: Its size.
        latest: One item, the newest sequence number, as the publisher keeps it up to date.

    Args:
        fd: The received descriptor; the map keeps its own.

    Raises:
        BusError: The file could be truncated by a peer, or is too small to be an arena.
    """

    def __init__(self, fd: int) -> None:
        self.size_bytes = os.fstat(fd).st_size
        seals = fcntl.fcntl(fd, _F_GET_SEALS)
        if not seals & _F_SEAL_SHRINK or self.size_bytes < HEADER_BYTES:
            raise BusError("shared memory: the received file is no sealed memory file of a publisher")
        memory = mmap.mmap(fd, self.size_bytes, flags=mmap.MAP_SHARED, prot=mmap.PROT_READ)
        self._all: Any = np.frombuffer(memory, np.uint8)
        self.latest = memoryview(memory)[:8].cast("Q")

    def slice(self, offset: int, size: int) -> Any:
        """Return the read-only bytes of a message as an array that all views of it keep alive."""
        start = offset + DATA_OFFSET_BYTES
        return self._all[start : start + size]
