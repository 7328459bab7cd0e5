"""A binary heap of events for compiled code: earliest first, equal times in the order of insertion.

An event is a time, a kind and an argument. The heap is two arrays that the caller owns: `slots` holds time,
order, kind and argument of each event, `sizes[0]` is how many there are and `sizes[1]` counts insertions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba as nb
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["new_heap", "pop", "push"]

_FIELDS = 4
_TIME, _ORDER = 0, 1


def new_heap(capacity: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return an empty heap for at most `capacity` events."""
    return np.zeros((capacity, _FIELDS), np.int64), np.zeros(2, np.int64)


@nb.njit(cache=True, nogil=True)
def _before(slots: Any, i: int, j: int) -> bool:
    if slots[i, _TIME] != slots[j, _TIME]:
        return bool(slots[i, _TIME] < slots[j, _TIME])
    return bool(slots[i, _ORDER] < slots[j, _ORDER])


@nb.njit(cache=True, nogil=True)
def _swap(slots: Any, i: int, j: int) -> None:
    for k in range(_FIELDS):
        slots[i, k], slots[j, k] = slots[j, k], slots[i, k]


@nb.njit(cache=True, nogil=True)
def push(slots: Any, sizes: Any, time_ns: int, kind: int, argument: int) -> None:
    """Insert an event.

    Raises:
        IndexError: The heap is full; the caller's capacity is wrong.
    """
    i = sizes[0]
    if i >= slots.shape[0]:
        raise IndexError("event heap is full")
    slots[i, 0], slots[i, 1], slots[i, 2], slots[i, 3] = time_ns, sizes[1], kind, argument
    sizes[0] += 1
    sizes[1] += 1
    while i > 0:
        parent = (i - 1) // 2
        if not _before(slots, i, parent):
            break
        _swap(slots, i, parent)
        i = parent


@nb.njit(cache=True, nogil=True)
def pop(slots: Any, sizes: Any) -> tuple[int, int, int]:
    """Remove the earliest event and return its time, kind and argument; the heap must not be empty."""
    time_ns, kind, argument = slots[0, 0], slots[0, 2], slots[0, 3]
    sizes[0] -= 1
    last = sizes[0]
    for k in range(_FIELDS):
        slots[0, k] = slots[last, k]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= last:
            break
        if child + 1 < last and _before(slots, child + 1, child):
            child += 1
        if not _before(slots, child, i):
            break
        _swap(slots, child, i)
        i = child
    return time_ns, kind, argument
