"""Fan-out of a publisher's messages: slots, their announcements, and their users; without sockets.

Each slot has a count of its users. Each subscriber has credits: the number of slots that it may hold at once.
Beyond them its newest announcements wait here and replace the oldest ones, so a slow or stopped subscriber
delays no other. Once half of the memory, or 256 MiB, is in use, a subscriber may hold only a small share of it.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from sfglab.bus.shm.wire import (
    DATA_OFFSET_BYTES,
    HEADER_BYTES,
    PAGE_BYTES,
    RETURN_MAX,
    Announcement,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

# Sizes are rounded up to four steps per octave, so at most a fifth of a slot is unused.
_STEPS_PER_OCTAVE = 4


class SlotPool:
    """Slots in an arena, each with a count of its users; the arena's first page is not for slots."""

    def __init__(self, arena_bytes: int) -> None:
        self.arena_bytes = arena_bytes
        self._end = HEADER_BYTES
        self._free: dict[int, list[int]] = {}  # capacity -> offsets
        self._capacity: dict[int, int] = {}  # offset -> capacity, of every slot ever made
        self._users: dict[int, int] = {}  # offset -> count, of those in use
        self.used_bytes = 0  #: Memory of the slots in use, bytes.

    def acquire(self, size: int) -> tuple[int, int] | None:
        """Return a free slot for `size` bytes, with one user; None if the arena is full.

        Returns:
            Offset of the slot, and the number of bytes added to the arena for it (0 for a reused slot).
        """
        capacity = slot_capacity(size)
        if not self._users and self._end + capacity > self.arena_bytes:
            self._forget()
        offset = self._reused(capacity)
        if offset is not None:
            self._use(offset)
            return offset, 0
        if self._end + capacity > self.arena_bytes:
            return None
        offset = self._end
        self._end += capacity
        self._capacity[offset] = capacity
        self._use(offset)
        return offset, capacity

    def _use(self, offset: int) -> None:
        self._users[offset] = 1
        self.used_bytes += self._capacity[offset]

    def retain(self, offset: int) -> None:
        """Count one more user of a slot in use."""
        self._users[offset] += 1

    def release(self, offset: int) -> None:
        """Count one user less; without users the slot is free."""
        self._users[offset] -= 1
        if self._users[offset] == 0:
            del self._users[offset]
            self.used_bytes -= self._capacity[offset]
            self._free.setdefault(self._capacity[offset], []).append(offset)

    def _forget(self) -> None:
        """Remove all slots, which are free, because their sizes are not requested any more."""
        self._end = HEADER_BYTES
        self._free.clear()
        self._capacity.clear()

    def _reused(self, capacity: int) -> int | None:
        """Take a free slot of this capacity, or a larger one if the arena is full."""
        if self._free.get(capacity):
            return self._free[capacity].pop()
        if self._end + capacity <= self.arena_bytes:
            return None
        larger = min(
            (c for c, offsets in self._free.items() if c > capacity and offsets), default=None
        )
        return None if larger is None else self._free[larger].pop()


def slot_capacity(size: int) -> int:
    """Return the size of a slot for `size` bytes of CDR: whole pages, four sizes per octave."""
    pages = -(-(size + DATA_OFFSET_BYTES) // PAGE_BYTES)
    step = max(1, (1 << (pages.bit_length() - 1)) // _STEPS_PER_OCTAVE)
    return -(-pages // step) * step * PAGE_BYTES


#: Largest number of slots that one subscriber may hold; their datagrams fit into a socket's default buffer.
MAX_CREDITS = 64
#: Number of equal parts of the memory; each subscriber may hold one part regardless of the others.
SHARES = 16
KEEP_ALL_BYTES = 256 * 2**20  #: Largest backlog of a KEEP_ALL subscriber, bytes, as elsewhere.

# Credits above the depth, so that a subscriber learns of newer messages while its application works on one.
_SPARE_CREDITS = 4


def credits_of(depth: int) -> int:
    """Return how many slots a subscriber with this depth (0 for all) may hold at once."""
    return min(depth + _SPARE_CREDITS, MAX_CREDITS) if depth else MAX_CREDITS


def returns_of(credits_: int) -> int:
    """Return how many slots a subscriber collects before it returns them, as long as it has credits left."""
    return max(1, min(credits_ // 3, RETURN_MAX))


class _Peer:
    __slots__ = ("backlog", "credits", "depth", "held", "waiting_bytes")

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.credits = credits_of(depth)
        self.held: dict[int, int] = {}  # offset -> size
        self.backlog: deque[Announcement] = deque()
        self.waiting_bytes = 0  # in the backlog

    def oldest(self) -> Announcement:
        """Remove and return the oldest announcement of the backlog."""
        announcement = self.backlog.popleft()
        self.waiting_bytes -= announcement.size
        return announcement


class Fanout:
    """Subscribers of one publisher, by any key; late ones receive the newest `history`: 0 none, None all."""

    def __init__(self, pool: SlotPool, history: int | None) -> None:
        self._pool = pool
        self._history_depth = history
        self._history: deque[Announcement] = deque()
        self._peers: dict[int, _Peer] = {}
        self._leaving: dict[int, set[int]] = {}

    @property
    def peers(self) -> tuple[int, ...]:
        """Keys of the subscribers that receive messages."""
        return tuple(self._peers)

    @property
    def idle(self) -> bool:
        """Whether no subscriber would receive a message and no history would keep it."""
        return not self._peers and self._history_depth == 0

    def backlog(self, key: int) -> int:
        """Return the number of announcements that wait until a subscriber returns slots."""
        return len(self._peers[key].backlog) if key in self._peers else 0

    def holds(self, key: int) -> bool:
        """Return whether a subscriber has slots that it may return."""
        return key in self._peers and bool(self._peers[key].held)

    def publish(self, announcement: Announcement) -> list[int]:
        """Take over a slot from its one user, the caller; return the keys of the subscribers to notify now."""
        told = [key for key, peer in self._peers.items() if self._give(peer, announcement)]
        if self._history_depth != 0:
            self._pool.retain(announcement.offset)
            self._history.append(announcement)
            while self._history_depth is not None and len(self._history) > self._history_depth:
                self._pool.release(self._history.popleft().offset)
        self._pool.release(announcement.offset)
        return told

    def join(self, key: int, depth: int, *, wants_history: bool) -> list[Announcement]:
        """Add a subscriber that holds at most `depth` messages (0: all); return the announcements to send to it first.

        With `wants_history` these are the latest kept messages, otherwise none.
        """
        peer = self._peers[key] = _Peer(depth)
        history = list(self._history)[-depth:] if wants_history else []
        return [announcement for announcement in history if self._give(peer, announcement)]

    def refuse(self, key: int, announcement: Announcement) -> None:
        """Put an announcement that could not be sent back in front of a subscriber's backlog."""
        peer = self._peers[key]
        peer.held.pop(announcement.offset, None)
        peer.backlog.appendleft(announcement)
        peer.waiting_bytes += announcement.size

    def returned(self, key: int, offset: int) -> list[Announcement]:
        """Take back a slot; return the announcements to send to the subscriber now.

        Raises:
            KeyError: The subscriber does not hold this slot.
        """
        peer = self._peers[key]
        del peer.held[offset]
        self._pool.release(offset)
        if not peer.backlog or not self._may_hold(peer, peer.backlog[0]):
            return []
        announcement = peer.oldest()
        peer.held[announcement.offset] = announcement.size
        return [announcement]

    def leaving(self, key: int) -> None:
        """Send a subscriber nothing more, but leave it the slots that it holds; unknown keys are ignored."""
        peer = self._peers.pop(key, None)
        if peer is not None:
            self._release(a.offset for a in peer.backlog)
            self._leaving[key] = set(peer.held)

    def gone(self, key: int) -> None:
        """Free all slots of a disconnected subscriber; unknown keys are ignored."""
        self.leaving(key)
        self._release(self._leaving.pop(key, ()))

    def shed(self) -> bool:
        """Drop the oldest announcement of the largest backlog, or of the history; return False if none."""
        longest = max(self._peers.values(), key=lambda peer: peer.waiting_bytes, default=None)
        if longest is not None and longest.backlog:
            self._pool.release(longest.oldest().offset)
            return True
        if len(self._history) > 1:
            self._pool.release(self._history.popleft().offset)
            return True
        return False

    def _give(self, peer: _Peer, announcement: Announcement) -> bool:
        """Count a peer as user of a slot; return whether to notify it now rather than later."""
        self._pool.retain(announcement.offset)
        if not peer.backlog and self._may_hold(peer, announcement):
            peer.held[announcement.offset] = announcement.size
            return True
        peer.backlog.append(announcement)
        peer.waiting_bytes += announcement.size
        if peer.depth:
            is_over = len(peer.backlog) > peer.depth
        else:
            is_over = peer.waiting_bytes > KEEP_ALL_BYTES and len(peer.backlog) > 1
        if is_over:
            self._pool.release(peer.oldest().offset)
        return False

    def _may_hold(self, peer: _Peer, announcement: Announcement) -> bool:
        """Return whether a subscriber may hold one more slot; it may always hold one."""
        own_bytes, arena = sum(peer.held.values()) + announcement.size, self._pool.arena_bytes
        is_room = (
            self._pool.used_bytes <= min(arena // 2, KEEP_ALL_BYTES) or own_bytes <= arena // SHARES
        )
        return not peer.held or (len(peer.held) < peer.credits and is_room)

    def _release(self, offsets: Iterable[int]) -> None:
        for offset in offsets:
            self._pool.release(offset)
