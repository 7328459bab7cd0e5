"""The tree of frames with time: transforms in, poses between any two frames at any time within the history out.

Semantics are tf2's where it has any: a frame has one parent, the last one told; static transforms hold for all
times; between two stamps positions are linear and orientations SLERP; nothing is extrapolated unless asked.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.spatial.poses import Pose, StampedTransform
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from sfglab.spatial.frames.kernel import Insertion


class FrameError(SfglabError):
    """A transform that cannot be had, or cannot be taken."""


class UnknownFrameError(FrameError, LookupError):
    """A frame that nobody has placed and in which nobody has placed anything."""


class NotConnectedError(FrameError, LookupError):
    """Two frames that stand in different trees."""


class ExtrapolationError(FrameError, LookupError):
    """A time for which the transforms on the way are not known."""


class FrameLoopError(FrameError, ValueError):
    """A transform that would place a frame below itself."""


_ALWAYS = np.iinfo(np.int64)


@dataclass(slots=True, kw_only=True)
class Edge:
    """What was observed of one edge from one publisher."""

    child: str  #: The frame that is placed.
    parent: str  #: The frame in which it is placed.
    static: bool = False  #: Whether it came as a static transform.
    authority: str = ""  #: Who published it; empty when unknown.
    count: int = 1  #: How many transforms came.
    first_ns: int = 0  #: The stamp of the first one that came.
    last_ns: int = 0  #: The stamp of the last one that came.
    backwards: int = 0  #: How often a stamp was older than the one that came before it.
    back_ns: int = 0  #: The largest step back, ns.

    def again(self, stamp_ns: int) -> None:
        """Take one more transform of it."""
        self.count += 1
        if stamp_ns < self.last_ns and not self.static:
            self.backwards += 1
            self.back_ns = max(self.back_ns, self.last_ns - stamp_ns)
        self.last_ns = stamp_ns


class FrameBuffer:
    """A tree of frames with a history of `history_s` back from each one's newest; None: all. For one thread.

    Raises:
        UnknownFrameError: By every method that is asked for a frame: nobody speaks of it.
        NotConnectedError: By those that are asked for two: they stand in different trees.
    """

    def __init__(self, *, history_s: float | None = 10.0) -> None:
        if history_s is not None and not history_s > 0:
            raise InvalidValueError("history_s", history_s, "seconds above 0, or None for all")
        from sfglab.spatial.frames import (
            kernel,  # numba takes 0.5 s to import, here rather than at a look-up
        )

        self._kernel = kernel
        self._history = kernel.History(None if history_s is None else round(history_s * NS_PER_S))
        self._index: dict[str, int] = {}
        self._names: list[str] = []
        self._edges: dict[tuple[str, str, bool, str], Edge] = {}
        self._out = np.empty(7)

    @property
    def frames(self) -> tuple[str, ...]:
        """The names of all frames, sorted."""
        return tuple(sorted(self._index))

    @property
    def edges(self) -> tuple[Edge, ...]:
        """All edges ever observed, also those that were refused or gave way to a later parent."""
        return tuple(map(replace, self._edges.values()))

    def insert(
        self, transform: StampedTransform, *, static: bool = False, authority: str = ""
    ) -> Insertion:
        """Take one transform, in any order of time, of whoever published it; return what became of it.

        Raises:
            InvalidValueError: A frame has no name.
            FrameLoopError: The child would stand below itself; the tree stays as it was.
        """
        self._observe(transform, static=static, authority=authority)
        child, parent = self._indexed(transform.child), self._indexed(transform.parent)
        if self._history.parent_of(child) != parent:
            self._check_loop(child, parent)
        self._history.place(child, parent, static=static)
        return self._history.insert(child, transform.stamp_ns, transform.pose)

    def look_up(
        self, target: str, source: str, time_ns: int | None = None, *, extrapolate_ns: int = 0
    ) -> Pose:
        """Return ``target_from_source``: where the source frame is in the target frame.

        Without `time_ns`, at the latest time at which all is known. `extrapolate_ns` continues the motion of
        the two nearest transforms beyond the first and last; a single one is held.

        Raises:
            ExtrapolationError: A transform on the way is not known at that time.
        """
        kernel = self._kernel
        to, of = self._known(target), self._known(source)
        if time_ns is None:
            both = self.interval(target, source)
            # where no time fits, the walk names the transform that lacks
            time_ns = 0 if both is None else min(both[1], _ALWAYS.max - 1)
        history = self._history
        fault = kernel.look_up(
            history.edges, history.stamps, history.poses, self._out, to, of, time_ns, extrapolate_ns
        )
        if fault == kernel.NOT_CONNECTED:
            raise self._not_connected(target, source)
        if fault != kernel.FOUND:
            raise self._not_known_at(target, source, fault, time_ns)
        x, y, z, qx, qy, qz, qw = self._out.tolist()
        return Pose._trusted((x, y, z), (qx, qy, qz, qw))  # noqa: SLF001 - numbers of poses that were checked

    def interval(self, target: str, source: str) -> tuple[int, int] | None:
        """Return from when until when all transforms between two frames are known.

        Returns:
            First and last time in ns, the ends of int64 where all are static; None when no time fits all.
        """
        kernel, history = self._kernel, self._history
        status, first_ns, last_ns = kernel.common_interval(
            history.edges, history.stamps, self._known(target), self._known(source)
        )
        if status == kernel.NOT_CONNECTED:
            raise self._not_connected(target, source)
        return (int(first_ns), int(last_ns)) if first_ns <= last_ns else None

    def parent_of(self, frame: str) -> str | None:
        """Return the frame in which a frame is placed; None for a root."""
        parent = self._history.parent_of(self._known(frame))
        return None if parent < 0 else self._names[parent]

    def root_of(self, frame: str) -> str:
        """Return the root of the tree in which a frame stands."""
        at = self._known(frame)
        while (parent := self._history.parent_of(at)) >= 0:
            at = parent
        return self._names[at]

    def __contains__(self, frame: str) -> bool:
        return frame in self._index

    def clear(self) -> None:
        """Forget all transforms, as after a jump of simulated time; the tree stays."""
        self._history.clear()

    def _observe(self, transform: StampedTransform, *, static: bool, authority: str) -> None:
        child, parent, stamp_ns = transform.child, transform.parent, transform.stamp_ns
        for name in (child, parent):
            if not name or name != name.strip():
                where = f"transform {parent!r} -> {child!r}"
                raise InvalidValueError(where, name, "names without outer blanks")
        key = (child, parent, static, authority)
        if key in self._edges:
            self._edges[key].again(stamp_ns)
        else:
            self._edges[key] = Edge(
                child=child,
                parent=parent,
                static=static,
                authority=authority,
                first_ns=stamp_ns,
                last_ns=stamp_ns,
            )

    def _indexed(self, name: str) -> int:
        index = self._index.get(name)
        if index is None:
            index = self._index[name] = self._history.add_frame()
            self._names.append(name)
        return index

    def _known(self, name: str) -> int:
        index = self._index.get(name)
        if index is None:
            near = ", ".join(map(repr, difflib.get_close_matches(name, self._index, n=3)))
            hint = f"did you mean {near}?" if near else f"{len(self._index)} frames are known"
            raise UnknownFrameError(f"frame {name!r} is unknown: {hint}")
        return index

    def _check_loop(self, child: int, parent: int) -> None:
        above = [child]
        at = parent
        while at >= 0:
            above.append(at)
            if at == child:
                loop = " -> ".join(self._names[i] for i in above)
                name = self._names[child]
                raise FrameLoopError(
                    f"frame {name!r} would stand below itself: {loop} (child -> parent)"
                )
            at = self._history.parent_of(at)

    def _not_connected(self, target: str, source: str) -> NotConnectedError:
        return NotConnectedError(
            f"frames {target!r} and {source!r} are not connected: the first stands below the root "
            f"{self.root_of(target)!r}, the other one below {self.root_of(source)!r}"
        )

    def _not_known_at(
        self, target: str, source: str, frame: int, time_ns: int
    ) -> ExtrapolationError:
        known = "never"
        if interval := self._history.interval_of(frame):
            first_ns, last_ns = interval
            off_ms = max(first_ns - time_ns, time_ns - last_ns) / NS_PER_MS
            side = "before" if time_ns < first_ns else "after"
            known = f"from {first_ns} to {last_ns} ns ({off_ms:.3f} ms {side} that)"
        return ExtrapolationError(
            f"{target!r} from {source!r} at {time_ns} ns: the transform of {self._names[frame]!r} is known "
            f"{known}; wait, ask for a time within, or allow extrapolation"
        )
