"""The history of a tree of frames, in arrays, and the compiled walk through it.

A tree is one table with a row per frame: parent (-1 for a root), whether static, first row and number of rows
in the history; the history holds stamps, ascending, and poses, x y z qx qy qz qw as ``parent_from_child``.
Every frame owns a block of rows; a full one is moved to its own beginning where that is free, or to one of
twice the size. Importing this module imports numba and, the first time on a machine, compiles. Trusts that
trees have no loops (`buffer`).
"""

from __future__ import annotations

import math
from enum import Enum
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from sfglab.compiling import compiled

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
    #: It is older than the newest one by more than the history, and was left out.
    TOO_OLD = "too old"


class History:
    """Stamps and poses of all frames, kept for `history_ns` before a frame's newest row; None keeps all."""

    def __init__(self, history_ns: int | None) -> None:
        self._history_ns = history_ns
        self._blocks: list[tuple[int, int]] = []
        self._used = 0
        #: Parent, static or not, first row and number of rows of every frame, shape (frames, 4).
        self.edges: NDArray[np.int64] = np.empty((0, 4), np.int64)
        self.stamps: NDArray[np.int64] = np.empty(0, np.int64)  #: Times in ns, shape (rows,).
        #: x y z qx qy qz qw, shape (rows, 7).
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


FOUND = -1
NOT_CONNECTED = -2

_NEARLY_PARALLEL = 1.0 - 1e-9


@numba.njit
def _turn(q: Any, v: Any) -> Any:
    x, y, z, w = q
    tx, ty, tz = (
        2.0 * (y * v[2] - z * v[1]),
        2.0 * (z * v[0] - x * v[2]),
        2.0 * (x * v[1] - y * v[0]),
    )
    return (
        v[0] + w * tx + y * tz - z * ty,
        v[1] + w * ty + z * tx - x * tz,
        v[2] + w * tz + x * ty - y * tx,
    )


@numba.njit
def _unit(x: Any, y: Any, z: Any, w: Any) -> Any:
    scale = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    return x * scale, y * scale, z * scale, w * scale


@numba.njit
def _compose(pa: Any, qa: Any, pb: Any, qb: Any) -> Any:
    """Return position and quaternion of the product a b."""
    t = _turn(qa, pb)
    ax, ay, az, aw = qa
    bx, by, bz, bw = qb
    q = _unit(
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
    return (pa[0] + t[0], pa[1] + t[1], pa[2] + t[2]), q


@numba.njit
def _between(poses: Any, row: Any, fraction: Any) -> Any:
    """Return the pose between a row and the next: position linear, orientation by SLERP."""
    a, b = poses[row], poses[row + 1]
    p = (
        a[0] + fraction * (b[0] - a[0]),
        a[1] + fraction * (b[1] - a[1]),
        a[2] + fraction * (b[2] - a[2]),
    )
    dot = a[3] * b[3] + a[4] * b[4] + a[5] * b[5] + a[6] * b[6]
    sign = -1.0 if dot < 0.0 else 1.0
    dot *= sign
    wa, wb = 1.0 - fraction, sign * fraction
    if dot <= _NEARLY_PARALLEL:
        angle = math.acos(dot)
        wa = math.sin((1.0 - fraction) * angle) / math.sin(angle)
        wb = sign * math.sin(fraction * angle) / math.sin(angle)
    q = _unit(
        wa * a[3] + wb * b[3], wa * a[4] + wb * b[4], wa * a[5] + wb * b[5], wa * a[6] + wb * b[6]
    )
    return p, q


@numba.njit
def _row_at(stamps: Any, first: Any, count: Any, time_ns: Any) -> Any:
    """Return the last row that is not after a time, or the first but one from the end that has a successor."""
    low, high = first, first + count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if stamps[middle] <= time_ns:
            low = middle
        else:
            high = middle
    return low


@numba.njit
def _edge_at(tree: Any, frame: Any, time_ns: Any, reach_ns: Any) -> Any:
    """Return whether a frame's pose in its parent is known at a time, and that pose."""
    edges, stamps, poses = tree
    first, count = edges[frame, 2], edges[frame, 3]
    if count == 0:
        return False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if edges[frame, 1] != 1:
        last = first + count - 1
        if time_ns < stamps[first] - reach_ns or time_ns > stamps[last] + reach_ns:
            return False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
        if count > 1:
            row = _row_at(stamps, first, count, time_ns)
            fraction = (time_ns - stamps[row]) / (stamps[row + 1] - stamps[row])
            p, q = _between(poses, row, fraction)
            return True, p, q
    pose = poses[first]
    return True, (pose[0], pose[1], pose[2]), (pose[3], pose[4], pose[5], pose[6])


@numba.njit
def _meeting(edges: Any, a: Any, b: Any) -> Any:
    """Return the first frame above both, or -1."""
    depth_a, depth_b = 0, 0
    up = a
    while edges[up, 0] >= 0:
        up = edges[up, 0]
        depth_a += 1
    root = up
    up = b
    while edges[up, 0] >= 0:
        up = edges[up, 0]
        depth_b += 1
    if up != root:
        return np.int64(-1)
    while depth_a > depth_b:
        a = edges[a, 0]
        depth_a -= 1
    while depth_b > depth_a:
        b = edges[b, 0]
        depth_b -= 1
    while a != b:
        a, b = edges[a, 0], edges[b, 0]
    return a


@compiled(
    "int64(int64[:, ::1], int64[::1], float64[:, ::1], float64[::1], int64, int64, int64, int64)"
)
def look_up(  # noqa: PLR0913, PLR0917 - flat arguments, as a compiled function has them
    edges: Any,
    stamps: Any,
    poses: Any,
    out: Any,
    target: Any,
    source: Any,
    time_ns: Any,
    reach_ns: Any,
) -> Any:
    """Write ``target_from_source`` at a time into `out`, shape (7,).

    Arguments are as in `History`; `reach_ns` is how far edges may be continued beyond their first and last row.

    Returns:
        `FOUND`, `NOT_CONNECTED`, or the frame whose pose at that time is not known.
    """
    top = _meeting(edges, target, source)
    if top < 0:
        return NOT_CONNECTED
    position, quat = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    while source != top:
        known, p, q = _edge_at((edges, stamps, poses), source, time_ns, reach_ns)
        if not known:
            return source
        position, quat = _compose(p, q, position, quat)
        source = edges[source, 0]
    base, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    while target != top:
        known, p, q = _edge_at((edges, stamps, poses), target, time_ns, reach_ns)
        if not known:
            return target
        base, turn = _compose(p, q, base, turn)
        target = edges[target, 0]
    back = (-turn[0], -turn[1], -turn[2], turn[3])
    offset = (position[0] - base[0], position[1] - base[1], position[2] - base[2])
    out[0], out[1], out[2] = _turn(back, offset)
    _, (out[3], out[4], out[5], out[6]) = _compose(base, back, base, quat)
    return FOUND


@compiled("UniTuple(int64, 3)(int64[:, ::1], int64[::1], int64, int64)")
def common_interval(edges: Any, stamps: Any, target: Any, source: Any) -> Any:
    """Return `FOUND` or `NOT_CONNECTED`, and when all edges on the way are known; the reverse: never."""
    always = np.iinfo(np.int64)
    begin, end = np.int64(always.min), np.int64(always.max)
    top = _meeting(edges, target, source)
    if top < 0:
        return np.int64(NOT_CONNECTED), begin, end
    for start in (target, source):
        frame = start
        while frame != top:
            first, count = edges[frame, 2], edges[frame, 3]
            if count == 0:
                return np.int64(FOUND), np.int64(always.max), np.int64(always.min)
            if edges[frame, 1] != 1:
                begin = max(begin, stamps[first])
                end = min(end, stamps[first + count - 1])
            frame = edges[frame, 0]
    return np.int64(FOUND), begin, end
