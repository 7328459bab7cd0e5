"""Which parts of a memory file are free, and who still uses the others.

Pure bookkeeping: offsets and counts, no memory. Slots of similar size are reused, the latest freed first
because it is still in the processor's cache.
"""

from __future__ import annotations

from sfglab.bus.shm.wire import DATA_OFFSET_BYTES, HEADER_BYTES, PAGE_BYTES

# Sizes are rounded up to four steps per octave, so at most a fifth of a slot is unused.
_STEPS_PER_OCTAVE = 4


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
