"""Rows of stamps and poses of all frames, ascending, in arrays that the compiled walk reads.

Every frame owns a block of the pool; a block that is full is moved to its own beginning where that is free, or
to one of twice the size. Rows older than the history are forgotten as new ones come. Knows numbers only.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.spatial.poses import Pose


_PARENT, _STATIC, _FIRST, _COUNT = range(4)
_SMALLEST_BLOCK = 16


class Insertion(Enum):
    """What became of a transform."""

    APPENDED = "appended"
    OUT_OF_ORDER = "out of order"  #: It is older than the newest one and was put in its place.
    REPLACED = "replaced"  #: There was one of the same stamp, or a static one.
    TOO_OLD = "too old"  #: It is older than the newest one by more than the history, and was left out.


class History:
    """Stamps and poses of all frames.

    Args:
        history_ns: How long before a frame's newest row rows are kept; None keeps all.

    Attributes:
        edges: Parent, static or not, first row and number of rows of every frame, shape (frames, 4).
        stamps: Times in ns, shape (rows,).
        poses: x y z qx qy qz qw, shape (rows, 7).
    """

    def __init__(self, history_ns: int | None) -> None:
        self._history_ns = history_ns
        self._blocks: list[tuple[int, int]] = []
        self._used = 0
        self.edges: NDArray[np.int64] = np.empty((0, 4), np.int64)
        self.stamps: NDArray[np.int64] = np.empty(0, np.int64)
        self.poses: NDArray[np.float64] = np.empty((0, 7), np.float64)

    def add_frame(self) -> int:
        """Return the index of a new frame, which has no parent."""
        self.edges = np.vstack([self.edges, np.array([[-1, 0, 0, 0]], np.int64)])
        self._blocks.append((0, 0))
        return len(self._blocks) - 1

    def parent_of(self, frame: int) -> int:
        """Return a frame's parent, -1 for a root."""
        return int(self.edges[frame, _PARENT])

    def interval_of(self, frame: int) -> tuple[int, int] | None:
        """Return the first and last stamp of a frame; None without rows."""
        _, _, first, count = self.edges[frame].tolist()
        return (int(self.stamps[first]), int(self.stamps[first + count - 1])) if count else None

    def place(self, frame: int, parent: int, *, static: bool) -> None:
        """Give a frame its parent; what was known of it below another one, or of other kind, is forgotten."""
        if self.edges[frame, _PARENT] == parent and self.edges[frame, _STATIC] == static:
            return
        self.edges[frame] = (parent, static, self._blocks[frame][0], 0)

    def insert(self, frame: int, stamp_ns: int, pose: Pose) -> Insertion:
        """Put one row where it belongs in time."""
        _, static, first, count = self.edges[frame].tolist()
        if static and count:
            return self._overwrite(first, stamp_ns, pose)
        newest = int(self.stamps[first + count - 1]) if count else None
        if newest is None or stamp_ns > newest:
            at = self._row_behind(frame)
            self._overwrite(at, stamp_ns, pose)
            self._forget(frame, stamp_ns)
            return Insertion.APPENDED
        if self._history_ns is not None and stamp_ns < newest - self._history_ns:
            return Insertion.TOO_OLD
        at = first + int(np.searchsorted(self.stamps[first : first + count], stamp_ns))
        if self.stamps[at] == stamp_ns:
            return self._overwrite(at, stamp_ns, pose)
        self._row_between(frame, at - first)
        self._overwrite(int(self.edges[frame, _FIRST]) + at - first, stamp_ns, pose)
        return Insertion.OUT_OF_ORDER

    def clear(self) -> None:
        """Forget all rows; frames and parents stay."""
        self.edges[:, _COUNT] = 0
        self.edges[:, _FIRST] = [start for start, _ in self._blocks]

    def _overwrite(self, row: int, stamp_ns: int, pose: Pose) -> Insertion:
        self.stamps[row] = stamp_ns
        self.poses[row] = pose.position_m + pose.quat_xyzw
        return Insertion.REPLACED

    def _row_behind(self, frame: int) -> int:
        """Return the free row behind a frame's last one, which now counts as one of its rows."""
        start, size = self._blocks[frame]
        _, _, first, count = self.edges[frame].tolist()
        if first + count == start + size:
            first = self._make_room(frame)
        self.edges[frame, _COUNT] = count + 1
        return int(first + count)

    def _row_between(self, frame: int, offset: int) -> None:
        """Move a frame's rows from an offset on by one."""
        end = self._row_behind(frame)
        at = int(self.edges[frame, _FIRST]) + offset
        for column in (self.stamps, self.poses):
            column[at + 1 : end + 1] = column[at:end].copy()

    def _forget(self, frame: int, newest_ns: int) -> None:
        if self._history_ns is None:
            return
        _, _, first, count = self.edges[frame].tolist()
        oldest_ns, old = newest_ns - self._history_ns, 0
        while self.stamps[first + old] < oldest_ns:
            old += 1
        if old:
            self.edges[frame, _FIRST:] = (first + old, count - old)

    def _make_room(self, frame: int) -> int:
        """Free the row behind a frame's last one and return its first one."""
        start, size = self._blocks[frame]
        _, _, first, count = self.edges[frame].tolist()
        to = start
        if not size or first - start < size // 2:
            to, size = self._used, max(_SMALLEST_BLOCK, 2 * size)
            self._grow_to(to + size)
            self._blocks[frame] = (to, size)
        for column in (self.stamps, self.poses):
            column[to : to + count] = column[first : first + count].copy()
        self.edges[frame, _FIRST] = to
        return to

    def _grow_to(self, rows: int) -> None:
        self._used = rows
        missing = rows - len(self.stamps)
        if missing > 0:
            more = max(missing, len(self.stamps))
            self.stamps = np.concatenate([self.stamps, np.zeros(more, np.int64)])
            self.poses = np.concatenate([self.poses, np.zeros((more, 7))])
