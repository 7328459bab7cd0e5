"""The tree of frames with time: transforms in, poses between any two frames at any time within the history out.

Knows names, trees and what was observed of every edge. Takes all times as values; refuses to know where
transforms come from (`listener`) and whether the tree is a good one (`lint`).

Semantics are tf2's where it has any: a frame has one parent, the last one told; static transforms hold for all
times; between two stamps positions are linear and orientations SLERP; nothing is extrapolated unless asked.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.errors import SfglabError
from sfglab.spatial.frames.history import History, Insertion
from sfglab.spatial.poses import Pose
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.spatial.poses import StampedTransform


class FrameError(SfglabError):
    """A transform that cannot be had, or cannot be taken."""


class FrameInputError(FrameError, ValueError):
    """A name that no frame can have, or a setting that no buffer can.

    Attributes:
        place: Where it stands.
        given: What was given.
    """

    def __init__(self, place: str, given: object, allowed: str) -> None:
        self.place = place
        self.given = given
        super().__init__(f"{place}: given {given!r}, allowed are {allowed}")


class UnknownFrameError(FrameError, LookupError):
    """A frame that nobody has placed and in which nobody has placed anything.

    Attributes:
        frame: As asked for.
        near: Known names that look similar, best first.
    """

    def __init__(self, frame: str, *, near: Sequence[str], known: int) -> None:
        self.frame = frame
        self.near = tuple(near)
        hint = f"did you mean {', '.join(map(repr, near))}?" if near else f"{known} frames are known"
        super().__init__(f"frame {frame!r} is unknown: {hint}")


class NotConnectedError(FrameError, LookupError):
    """Two frames that stand in different trees.

    Attributes:
        target: One frame.
        source: The other one.
        target_root: The root above the first.
        source_root: The root above the other.
    """

    def __init__(self, target: str, source: str, *, target_root: str, source_root: str) -> None:
        self.target = target
        self.source = source
        self.target_root = target_root
        self.source_root = source_root
        super().__init__(
            f"frames {target!r} and {source!r} are not connected: the first stands below the root "
            f"{target_root!r}, the other one below {source_root!r}"
        )


class ExtrapolationError(FrameError, LookupError):
    """A time for which the transforms on the way are not known.

    Attributes:
        frame: The frame on the way whose transform is missing.
        time_ns: The time asked for.
        first_ns: From when that frame's transform is known; None if it never was.
        last_ns: Until when.
    """

    def __init__(  # noqa: PLR0913 - each of them is in the message
        self, target: str, source: str, *, frame: str, time_ns: int, first_ns: int | None, last_ns: int | None
    ) -> None:
        self.frame = frame
        self.time_ns = time_ns
        self.first_ns = first_ns
        self.last_ns = last_ns
        known = "never" if first_ns is None else f"from {first_ns} to {last_ns} ns{self._by_how_much()}"
        super().__init__(
            f"{target!r} from {source!r} at {time_ns} ns: the transform of {frame!r} is known {known}; "
            "wait, ask for a time within, or allow extrapolation"
        )

    def _by_how_much(self) -> str:
        assert self.first_ns is not None
        assert self.last_ns is not None
        off_ns = max(self.first_ns - self.time_ns, self.time_ns - self.last_ns)
        return f" ({off_ns / 1e6:.3f} ms {'before' if self.time_ns < self.first_ns else 'after'} that)"


class FrameLoopError(FrameError, ValueError):
    """A transform that would place a frame below itself.

    Attributes:
        loop: The frames, from the child up to itself again.
    """

    def __init__(self, loop: Sequence[str]) -> None:
        self.loop = tuple(loop)
        super().__init__(f"frame {loop[0]!r} would stand below itself: {' -> '.join(loop)} (child -> parent)")


_ALWAYS = np.iinfo(np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
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


@dataclass(slots=True)
class _Tally:
    """What changes of an `Edge` with every transform."""

    first_ns: int
    last_ns: int
    count: int = 0
    backwards: int = 0
    back_ns: int = 0


class FrameBuffer:
    """A tree of frames with a history, for one thread.

    Args:
        history_s: How long transforms are kept, counted back from each frame's newest; None keeps all.
    """

    def __init__(self, *, history_s: float | None = 10.0) -> None:
        if history_s is not None and not history_s > 0:
            raise FrameInputError("history_s", history_s, "seconds above 0, or None for all")
        from sfglab.spatial.frames import kernel  # numba takes 0.5 s to import, here rather than at a look-up

        self._kernel = kernel
        self._history = History(None if history_s is None else round(history_s * NS_PER_S))
        self._index: dict[str, int] = {}
        self._names: list[str] = []
        self._tallies: dict[tuple[str, str, bool, str], _Tally] = {}
        self._out = np.empty(7)

    @property
    def frames(self) -> tuple[str, ...]:
        """The names of all frames, sorted."""
        return tuple(sorted(self._index))

    @property
    def edges(self) -> tuple[Edge, ...]:
        """All edges ever observed, also those that were refused or gave way to a later parent."""
        return tuple(
            Edge(
                child=child,
                parent=parent,
                static=static,
                authority=authority,
                count=tally.count,
                first_ns=tally.first_ns,
                last_ns=tally.last_ns,
                backwards=tally.backwards,
                back_ns=tally.back_ns,
            )
            for (child, parent, static, authority), tally in self._tallies.items()
        )

    def insert(self, transform: StampedTransform, *, static: bool = False, authority: str = "") -> Insertion:
        """Take one transform.

        Args:
            transform: Where the child is in the parent; stamps may come in any order within the history.
            static: Whether it holds for all times.
            authority: Who published it, for the lint.

        Returns:
            What became of it.

        Raises:
            FrameInputError: A frame has no name.
            FrameLoopError: The child would stand below itself; the tree stays as it was.
        """
        self._observe(transform, static=static, authority=authority)
        child, parent = self._indexed(transform.child), self._indexed(transform.parent)
        if self._history.parent_of(child) != parent:
            self._check_loop(child, parent)
        self._history.place(child, parent, static=static)
        return self._history.insert(child, transform.stamp_ns, transform.pose)

    def look_up(self, target: str, source: str, time_ns: int | None = None, *, extrapolate_ns: int = 0) -> Pose:
        """Return where the source frame is in the target frame.

        Args:
            target: The frame in which the answer is given.
            source: The frame whose place is asked for.
            time_ns: When; None is the latest time at which all transforms on the way are known.
            extrapolate_ns: By how much a motion may be continued beyond the first and last transform, at the
                rate of the two nearest; a single one is held.

        Returns:
            ``target_from_source``.

        Raises:
            UnknownFrameError: Nobody speaks of one of the frames.
            NotConnectedError: The frames stand in different trees.
            ExtrapolationError: A transform on the way is not known at that time.
        """
        kernel = self._kernel
        to, of = self._known(target), self._known(source)
        if time_ns is None:
            time_ns = self._latest(target, source)
        history = self._history
        fault = kernel.look_up(
            history.edges, history.stamps, history.poses, self._out, to, of, time_ns, extrapolate_ns
        )
        if fault == kernel.NOT_CONNECTED:
            raise self._not_connected(target, source)
        if fault != kernel.FOUND:
            first_ns, last_ns = history.interval_of(fault) or (None, None)
            raise ExtrapolationError(
                target,
                source,
                frame=self._names[fault],
                time_ns=time_ns,
                first_ns=first_ns,
                last_ns=last_ns,
            )
        x, y, z, qx, qy, qz, qw = self._out.tolist()
        return Pose._trusted((x, y, z), (qx, qy, qz, qw))  # noqa: SLF001 - numbers of poses that were checked

    def interval(self, target: str, source: str) -> tuple[int, int] | None:
        """Return from when until when all transforms between two frames are known.

        Args:
            target: One frame.
            source: The other one.

        Returns:
            First and last time in ns, the ends of int64 where all are static; None when no time fits all.

        Raises:
            UnknownFrameError: Nobody speaks of one of the frames.
            NotConnectedError: The frames stand in different trees.
        """
        kernel, history = self._kernel, self._history
        status, first_ns, last_ns = kernel.common_interval(
            history.edges, history.stamps, self._known(target), self._known(source)
        )
        if status == kernel.NOT_CONNECTED:
            raise self._not_connected(target, source)
        return (int(first_ns), int(last_ns)) if first_ns <= last_ns else None

    def parent_of(self, frame: str) -> str | None:
        """Return the frame in which a frame is placed; None for a root.

        Raises:
            UnknownFrameError: Nobody speaks of the frame.
        """
        parent = self._history.parent_of(self._known(frame))
        return None if parent < 0 else self._names[parent]

    def root_of(self, frame: str) -> str:
        """Return the root of the tree in which a frame stands.

        Raises:
            UnknownFrameError: Nobody speaks of the frame.
        """
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
                raise FrameInputError(f"transform {parent!r} -> {child!r}", name, "names without outer blanks")
        key = (child, parent, static, authority)
        tally = self._tallies.get(key)
        if tally is None:
            tally = self._tallies[key] = _Tally(stamp_ns, stamp_ns)
        tally.count += 1
        if stamp_ns < tally.last_ns and not static:
            tally.backwards += 1
            tally.back_ns = max(tally.back_ns, tally.last_ns - stamp_ns)
        tally.last_ns = stamp_ns

    def _indexed(self, name: str) -> int:
        index = self._index.get(name)
        if index is None:
            index = self._index[name] = self._history.add_frame()
            self._names.append(name)
        return index

    def _known(self, name: str) -> int:
        index = self._index.get(name)
        if index is None:
            near = difflib.get_close_matches(name, self._index, n=3)
            raise UnknownFrameError(name, near=near, known=len(self._index))
        return index

    def _check_loop(self, child: int, parent: int) -> None:
        above = [child]
        at = parent
        while at >= 0:
            above.append(at)
            if at == child:
                raise FrameLoopError([self._names[i] for i in above])
            at = self._history.parent_of(at)

    def _latest(self, target: str, source: str) -> int:
        known = self.interval(target, source)
        if known is not None:
            return min(known[1], _ALWAYS.max - 1)
        return 0  # no time fits; the walk will name the transform that lacks

    def _not_connected(self, target: str, source: str) -> NotConnectedError:
        return NotConnectedError(
            target, source, target_root=self.root_of(target), source_root=self.root_of(source)
        )
