"""The compiled walk through a tree of frames, with interpolation on every edge.

A tree is one table with a row per frame: parent (-1 for a root), whether static, first row and number of rows
in the history; the history holds stamps, ascending, and poses, x y z qx qy qz qw as ``parent_from_child``.
Importing this module imports numba and, the first time on a machine, compiles. Trusts its input: that rows
ascend (`history`) and that trees have no loops (`buffer`). Refuses to know names.
"""

from __future__ import annotations

import logging
import math
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable


_log = logging.getLogger(__name__)

FOUND = -1
NOT_CONNECTED = -2

_NEARLY_PARALLEL = 1.0 - 1e-9


def _compiled(signature: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator that compiles at once, from the cache where there is a writable one."""

    def compile_now(function: Callable[..., Any]) -> Callable[..., Any]:
        try:
            return numba.njit(signature, nogil=True, cache=True)(function)
        except RuntimeError as error:  # numba found no directory that it may write
            _log.warning("%s is compiled anew in each process; set NUMBA_CACHE_DIR: %s", function, error)
            return numba.njit(signature, nogil=True)(function)

    return compile_now


@numba.njit
def _turn(q: Any, v: Any) -> Any:
    x, y, z, w = q
    tx, ty, tz = 2.0 * (y * v[2] - z * v[1]), 2.0 * (z * v[0] - x * v[2]), 2.0 * (x * v[1] - y * v[0])
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
    q = _unit(wa * a[3] + wb * b[3], wa * a[4] + wb * b[4], wa * a[5] + wb * b[5], wa * a[6] + wb * b[6])
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


@_compiled("int64(int64[:, ::1], int64[::1], float64[:, ::1], float64[::1], int64, int64, int64, int64)")
def look_up(  # noqa: PLR0913, PLR0917 - flat arguments, as a compiled function has them
    edges: Any, stamps: Any, poses: Any, out: Any, target: Any, source: Any, time_ns: Any, reach_ns: Any
) -> Any:
    """Write ``target_from_source`` at a time into `out`.

    Args:
        edges: The tree, shape (frames, 4).
        stamps: The history's times.
        poses: The history's poses, shape (rows, 7).
        out: Result, shape (7,).
        target: One frame.
        source: The other one.
        time_ns: When.
        reach_ns: How far an edge may be continued beyond its first and last row.

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


@_compiled("UniTuple(int64, 3)(int64[:, ::1], int64[::1], int64, int64)")
def common_interval(edges: Any, stamps: Any, target: Any, source: Any) -> Any:
    """Return `FOUND` or `NOT_CONNECTED`, and from when until when all edges on the way are known.

    Static edges are known always, so that a way of only those is known from the first to the last int64; one
    with an edge that was never known gets the reverse.
    """
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
