"""Buffer of transforms: it gives the pose between any two frames at any time of the history.

The semantics are those of tf2. A frame has one parent, that of the latest transform. Static transforms are valid
at all times. Between two stamps, positions are interpolated linearly and orientations by SLERP.
Extrapolation must be requested. The module is plain Python: a lookup over 12 edges takes less than 0.1 ms
(`benchmarks/frames.py`).
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.spatial.poses import Pose
from sfglab.units import NS_PER_S
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.spatial.poses import StampedTransform


class FrameError(SfglabError):
    """A transform that is not available, or cannot be inserted."""


class UnknownFrameError(FrameError, LookupError):
    """A frame that occurs in no transform."""


class NotConnectedError(FrameError, LookupError):
    """Two frames in different trees."""


class ExtrapolationError(FrameError, LookupError):
    """A time at which a transform between the frames is not known."""


class FrameLoopError(FrameError, ValueError):
    """A transform that would place a frame below itself."""


_IDENTITY = Pose()
_FIRST_NS, _LAST_NS = -(2**63), 2**63 - 1  # ends of int64


@dataclass(slots=True, kw_only=True)
class Edge:
    """Transforms of one frame in one parent, from one publisher."""

    child: str  #: Child frame.
    parent: str  #: Parent frame.
    static: bool = False  #: Whether the transforms are static.
    authority: str = ""  #: Publisher of the transforms; empty if unknown.
    count: int = 1  #: Number of transforms.
    first_ns: int = 0  #: Stamp of the first received transform, ns.
    last_ns: int = 0  #: Stamp of the last received transform, ns.
    backwards: int = 0  #: Number of transforms with an older stamp than the one received before.
    back_ns: int = 0  #: Largest step back, ns.
    #: Number of transforms with another pose than an earlier one for the same time: the same stamp, or
    #: any time if static.
    contradicting: int = 0

    def add(self, stamp_ns: int) -> None:
        """Count one more transform with its stamp, ns."""
        self.count += 1
        if stamp_ns < self.last_ns and not self.static:
            self.backwards += 1
            self.back_ns = max(self.back_ns, self.last_ns - stamp_ns)
        self.last_ns = stamp_ns


class _Frame:
    """A frame with its parent and the poses in it, in order of their stamps."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.parent: _Frame | None = None
        self.is_static = False
        self.stamps: list[int] = []
        self.poses: list[Pose] = []

    def above(self) -> list[_Frame]:
        """Return the frame itself and all frames above it, the root last."""
        frame, found = self, [self]
        while frame.parent is not None:
            frame = frame.parent
            found.append(frame)
        return found

    def insert(self, stamp_ns: int, pose: Pose, history_ns: int | None) -> bool:
        """Insert a pose; return whether it replaced another pose of the same time."""
        stamps = self.stamps
        if self.is_static and stamps:
            return self._overwrite(0, stamp_ns, pose)
        if history_ns is not None and stamps and stamp_ns < stamps[-1] - history_ns:
            return False
        at = bisect_left(stamps, stamp_ns)
        if at < len(stamps) and stamps[at] == stamp_ns:
            return self._overwrite(at, stamp_ns, pose)
        stamps.insert(at, stamp_ns)
        self.poses.insert(at, pose)
        if history_ns is not None:
            old = bisect_left(stamps, stamps[-1] - history_ns)
            del stamps[:old], self.poses[:old]
        return False

    def _overwrite(self, at: int, stamp_ns: int, pose: Pose) -> bool:
        is_other = not pose.same_as(self.poses[at])
        self.stamps[at], self.poses[at] = stamp_ns, pose
        return is_other

    def pose_at(self, time_ns: int, reach_ns: int) -> Pose | None:
        """Return the pose in the parent at a time, ns; None if it is not known with `reach_ns` of extrapolation."""
        stamps = self.stamps
        if self.is_static and stamps:
            return self.poses[0]
        if not stamps or not stamps[0] - reach_ns <= time_ns <= stamps[-1] + reach_ns:
            return None
        if len(stamps) == 1:
            return self.poses[0]
        after = bisect_right(stamps, time_ns, 1, len(stamps) - 1)
        before = after - 1
        fraction = (time_ns - stamps[before]) / (stamps[after] - stamps[before])
        return self.poses[before].interpolate(self.poses[after], fraction)


class FrameBuffer:
    """A TF tree with a history of each frame, for use in one thread.

    Args:
        history_s: Length of the history before the newest transform of a frame, s; None: unlimited.

    Raises:
        UnknownFrameError: A method was given a frame that occurs in no transform.
        NotConnectedError: A method was given two frames of different trees.
    """

    def __init__(self, *, history_s: float | None = 10.0) -> None:
        self._history_ns = None if history_s is None else round(history_s * NS_PER_S)
        self._frames: dict[str, _Frame] = {}
        self._edges: dict[tuple[str, str, bool, str], Edge] = {}

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(sorted(self._frames))

    @property
    def edges(self) -> tuple[Edge, ...]:
        """All edges that were received, including rejected ones and those with a former parent."""
        return tuple(map(replace, self._edges.values()))

    def insert(
        self, transform: StampedTransform, *, static: bool = False, authority: str = ""
    ) -> None:
        """Insert one transform. Transforms may arrive in any order; those beyond the history are dropped.

        Args:
            transform: The transform.
            static: Whether the transform is static.
            authority: Name of the publisher; empty if unknown.

        Raises:
            InvalidValueError: A frame has no name.
            FrameLoopError: The child would be below itself; the tree is unchanged.
        """
        edge = self._count(transform, static=static, authority=authority)
        child, parent = self._frame(transform.child), self._frame(transform.parent)
        if child.parent is not parent:
            _check_loop(child, parent)
        if child.parent is not parent or child.is_static != static:
            child.parent, child.is_static = parent, static
            child.stamps, child.poses = [], []
        is_other = child.insert(transform.stamp_ns, transform.pose, self._history_ns)
        edge.contradicting += is_other

    def look_up(
        self, target: str, source: str, time_ns: int | None = None, *, extrapolate_ns: int = 0
    ) -> Pose:
        """Return ``target_from_source``, the pose of the source frame in the target frame.

        Args:
            target: Target frame.
            source: Source frame.
            time_ns: Time, ns; None: the latest time at which all transforms are known.
            extrapolate_ns: Time by which the motion of the two nearest transforms is continued before
                the first and after the last one, ns. A single transform is held.

        Raises:
            ExtrapolationError: A transform between the frames is not known at that time.
        """
        up, down = self._ways(target, source)
        if time_ns is None:
            interval = _common_interval([*up, *down])
            time_ns = 0 if interval is None else interval[1]
        poses = []
        for way in (up, down):
            pose = _IDENTITY
            for frame in way:
                step = frame.pose_at(time_ns, extrapolate_ns)
                if step is None:
                    raise _not_known_at(target, source, frame, time_ns)
                pose = step if pose is _IDENTITY else step @ pose
            poses.append(pose)
        top_from_target, top_from_source = poses
        return top_from_target.inverse() @ top_from_source if up else top_from_source

    def interval(self, target: str, source: str) -> tuple[int, int] | None:
        """Return the time interval in which all transforms between two frames are known.

        Returns:
            First and last time, ns; the ends of int64 if all transforms are static; None if there is no
            such time.
        """
        up, down = self._ways(target, source)
        return _common_interval([*up, *down])

    def parent_of(self, frame: str) -> str | None:
        """Return the parent of a frame; None for a root."""
        parent = self._known(frame).parent
        return None if parent is None else parent.name

    def __contains__(self, frame: str) -> bool:
        return frame in self._frames

    def _count(self, transform: StampedTransform, *, static: bool, authority: str) -> Edge:
        child, parent, stamp_ns = transform.child, transform.parent, transform.stamp_ns
        for name in (child, parent):
            if not name:
                where = f"transform {parent!r} -> {child!r}"
                raise InvalidValueError(where, name, "the names of two frames")
        key = (child, parent, static, authority)
        edge = self._edges.get(key)
        if edge is None:
            edge = self._edges[key] = Edge(
                child=child,
                parent=parent,
                static=static,
                authority=authority,
                first_ns=stamp_ns,
                last_ns=stamp_ns,
            )
        else:
            edge.add(stamp_ns)
        return edge

    def _frame(self, name: str) -> _Frame:
        frame = self._frames.get(name)
        if frame is None:
            frame = self._frames[name] = _Frame(name)
        return frame

    def _known(self, name: str) -> _Frame:
        frame = self._frames.get(name)
        if frame is None:
            raise UnknownFrameError(f"frame {name!r} is unknown{suggestion(name, self._frames)}")
        return frame

    def _ways(self, target: str, source: str) -> tuple[list[_Frame], list[_Frame]]:
        """Return the frames from each of two frames up to, but without, the first one above both."""
        up, down = self._known(target).above(), self._known(source).above()
        if up[-1] is not down[-1]:
            raise NotConnectedError(
                f"frames {target!r} and {source!r} are not connected: the root of the first is "
                f"{up[-1].name!r}, that of the other {down[-1].name!r}; publish a transform between them"
            )
        while up and down and up[-1] is down[-1]:
            del up[-1], down[-1]
        return up, down


def _check_loop(child: _Frame, parent: _Frame) -> None:
    above = parent.above()
    if child in above:
        loop = [child, *above[: above.index(child) + 1]]
        names = " -> ".join(frame.name for frame in loop)
        raise FrameLoopError(
            f"frame {child.name!r} would be below itself: {names} (child -> parent)"
        )


def _common_interval(frames: Sequence[_Frame]) -> tuple[int, int] | None:
    """Return first and last time at which the poses of all frames are known; None: there is none."""
    first_ns, last_ns = _FIRST_NS, _LAST_NS
    for frame in frames:
        if not frame.stamps:
            return None
        if not frame.is_static:
            first_ns = max(first_ns, frame.stamps[0])
            last_ns = min(last_ns, frame.stamps[-1])
    return (first_ns, last_ns) if first_ns <= last_ns else None


def _not_known_at(target: str, source: str, frame: _Frame, time_ns: int) -> ExtrapolationError:
    known = "never"
    if frame.stamps:
        known = f"from {frame.stamps[0]} to {frame.stamps[-1]} ns"
    return ExtrapolationError(
        f"{target!r} from {source!r} at {time_ns} ns: the transform of {frame.name!r} is known "
        f"{known}; wait, ask for a time within, or allow extrapolation"
    )
