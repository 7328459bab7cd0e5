"""A binary heap of events for compiled code: earliest first, equal times in the order of insertion.

An event is a time, a kind and an argument. The heap is two arrays that the caller owns: `slots` holds each
event's time, and in one word its order (from bit 23), argument (20 bits) and kind (3 bits); `sizes[0]` is how
many there are and `sizes[1]` counts insertions. Events move into a gap and are not swapped: half the traffic.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.rtps.world import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray


_FIELDS = 2
_ARGUMENT_BITS, _KIND_BITS = 20, 3


def new_heap(capacity: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return an empty heap for at most `capacity` events."""
    return np.zeros((capacity, _FIELDS), np.int64), np.zeros(2, np.int64)


@compiled
def push(slots: Any, sizes: Any, time_ns: int, kind: int, argument: int) -> None:
    """Insert an event.

    Raises:
        IndexError: The heap is full; the caller's capacity is wrong.
    """
    i = sizes[0]
    if i >= slots.shape[0]:
        raise IndexError("event heap is full")
    key = (sizes[1] << (_ARGUMENT_BITS + _KIND_BITS)) | (argument << _KIND_BITS) | kind
    sizes[0] += 1
    sizes[1] += 1
    while i > 0:
        parent = (i - 1) >> 1
        if slots[parent, 0] <= time_ns:  # the newest is last among equals
            break
        slots[i, 0] = slots[parent, 0]
        slots[i, 1] = slots[parent, 1]
        i = parent
    slots[i, 0] = time_ns
    slots[i, 1] = key


@compiled
def pop(slots: Any, sizes: Any) -> tuple[int, int, int]:
    """Remove the earliest event and return its time, kind and argument; the heap must not be empty."""
    time_ns, key = slots[0, 0], slots[0, 1]
    sizes[0] -= 1
    last = sizes[0]
    late_t, late_k = slots[last, 0], slots[last, 1]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= last:
            break
        if child + 1 < last:
            a, b = slots[child, 0], slots[child + 1, 0]
            if b < a or (b == a and slots[child + 1, 1] < slots[child, 1]):
                child += 1
        t = slots[child, 0]
        if t > late_t or (t == late_t and slots[child, 1] > late_k):
            break
        slots[i, 0] = t
        slots[i, 1] = slots[child, 1]
        i = child
    slots[i, 0] = late_t
    slots[i, 1] = late_k
    return time_ns, key & 7, (key >> _KIND_BITS) & 0xFFFFF
