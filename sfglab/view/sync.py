"""Synchronisation of messages of several topics: exact and approximate time, and latest.

Pure: knows stamps and opaque items. Every policy keeps the promises of ROS 2's message_filters: an item is
handed out once at most, sets come out in the order of time, and what waits is bounded by `depth` items of each
topic. What is dropped unmatched is counted, and so is an item that is not newer than the last one of its topic;
a clock that jumps back needs `clear`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from sfglab.errors import InvalidValueError

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Independent:
    """Every message is a set of its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exact:
    """The stamps of a set are equal."""

    depth: int = 10  #: Items of each topic that wait for their partners.

    def __post_init__(self) -> None:
        _check_depth(self.depth)


@dataclass(frozen=True, slots=True, kw_only=True)
class Approximate:
    """The stamps of a set lie within `slop_ns`, and each set is the best for its pivot.

    The pivot is the latest of the topics' oldest waiting items: no set without it can still get better. Its
    partners are the nearest items of the other topics, which is known once these have reached its stamp; so a
    set whose stamps differ comes out with the next item of the topic that is behind, or when a queue is full.
    """

    slop_ns: int = 50_000_000  #: Largest difference between two stamps of a set, in nanoseconds.
    depth: int = 10  #: Items of each topic that wait for their partners.

    def __post_init__(self) -> None:
        _check_depth(self.depth)
        if self.slop_ns < 0:
            raise InvalidValueError("slop_ns", self.slop_ns, "nanoseconds from 0")


@dataclass(frozen=True, slots=True, kw_only=True)
class Latest:
    """Every item of the first topic, once at most, with the latest of each other, which changes rarely."""


PATIENCE = 5
"""How many items of the first topic find no partners before what was said once is taken to hold for good."""

SyncPolicy = Independent | Exact | Approximate | Latest


@dataclass(frozen=True, slots=True, kw_only=True)
class Matched(Generic[T]):
    """Items that belong together."""

    items: dict[str, tuple[int, T]]  #: Stamp (ns) and item by topic.

    @property
    def stamp_ns(self) -> int:
        """The stamp of the first topic's item, or of the only one."""
        return next(iter(self.items.values()))[0]


class Synchronizer(Generic[T]):
    """The queues of several topics, the leading one first, `depth` items each; made by `synchronizer`."""

    def __init__(self, topics: tuple[str, ...], *, depth: int) -> None:
        self.unmatched = 0  #: Items dropped because their partners did not come.
        self.disordered = 0  #: Items dropped because they were not newer than the one before.
        self._depth = depth
        self._queues: dict[str, deque[tuple[int, T]]] = {topic: deque() for topic in topics}
        self._last_ns: dict[str, int] = {}

    @property
    def waiting(self) -> int:
        """How many items wait for their partners."""
        return sum(map(len, self._queues.values()))

    def offer(self, topic: str, stamp_ns: int, item: T) -> list[Matched[T]]:
        """Take one item and return the sets that it completes, the oldest first."""
        if stamp_ns <= self._last_ns.get(topic, stamp_ns - 1):
            self.disordered += 1
            return []
        self._last_ns[topic] = stamp_ns
        self._queues[topic].append((stamp_ns, item))
        found = self._matched()
        while len(self._queues[topic]) > self._depth:
            self._drop_oldest(topic)
            found += self._matched()
        return found

    def clear(self) -> None:
        """Forget everything that waits, and that time has passed."""
        self._last_ns.clear()
        for queue in self._queues.values():
            queue.clear()

    def _matched(self) -> list[Matched[T]]:
        raise NotImplementedError

    def _drop_oldest(self, topic: str) -> None:
        self._queues[topic].popleft()
        self.unmatched += 1

    def _drop_before(self, stamp_ns: int) -> None:
        for topic, queue in self._queues.items():
            while queue and queue[0][0] < stamp_ns:
                self._drop_oldest(topic)

    def _hand_out(self, indexes: dict[str, int]) -> Matched[T]:
        """Remove one item of each queue and what is older there."""
        items = {}
        for topic, index in indexes.items():
            for _ in range(index):
                self._drop_oldest(topic)
            items[topic] = self._queues[topic].popleft()
        return Matched(items=items)


class _ExactSynchronizer(Synchronizer[T]):
    def _matched(self) -> list[Matched[T]]:
        found = []
        while all(self._queues.values()):
            latest_ns = max(queue[0][0] for queue in self._queues.values())
            self._drop_before(latest_ns)
            if all(queue and queue[0][0] == latest_ns for queue in self._queues.values()):
                found.append(self._hand_out(dict.fromkeys(self._queues, 0)))
        return found


class _ApproximateSynchronizer(Synchronizer[T]):
    def __init__(self, topics: tuple[str, ...], *, depth: int, slop_ns: int) -> None:
        super().__init__(topics, depth=depth)
        self._slop_ns = slop_ns

    def _matched(self) -> list[Matched[T]]:
        found = []
        while all(self._queues.values()):
            pivot_ns = max(queue[0][0] for queue in self._queues.values())
            self._drop_before(pivot_ns - self._slop_ns)
            heads = [queue[0][0] for queue in self._queues.values() if queue]
            if len(heads) < len(self._queues):
                break
            if max(heads) != pivot_ns:
                continue  # what was dropped made room for a later pivot
            if not self._is_decided(pivot_ns):
                break
            found.append(self._hand_out(self._best(pivot_ns)))
        return found

    def _is_decided(self, pivot_ns: int) -> bool:
        """Return whether every topic has reached the pivot, or one cannot wait any longer."""
        queues = self._queues.values()
        return any(len(q) > self._depth for q in queues) or all(
            q[-1][0] >= pivot_ns for q in queues
        )

    def _best(self, pivot_ns: int) -> dict[str, int]:
        """Return the nearest items to the pivot; where those lie too far apart, the last ones not after it."""
        nearest = {topic: _nearest(queue, pivot_ns) for topic, queue in self._queues.items()}
        stamps = [self._queues[topic][index][0] for topic, index in nearest.items()]
        if max(stamps) - min(stamps) <= self._slop_ns:
            return nearest
        return {topic: _last_until(queue, pivot_ns) for topic, queue in self._queues.items()}


class _LatestSynchronizer(Synchronizer[T]):
    """Holds the latest item of each topic but the first, and one of the first until all others have spoken."""

    def _matched(self) -> list[Matched[T]]:
        leading, *others = self._queues
        for topic in self._queues:
            while len(self._queues[topic]) > 1:
                self._queues[topic].popleft()
                self.unmatched += topic == leading
        if not all(self._queues.values()):
            return []
        items = {leading: self._queues[leading].popleft()}
        return [Matched(items={**items, **{topic: self._queues[topic][0] for topic in others}})]


class _SteadySynchronizer(Synchronizer[T]):
    """Matches by stamps, unless steady topics spoke only once, as of a calibration: then that item holds."""

    def __init__(
        self, policy: SyncPolicy, topics: tuple[str, ...], steady: tuple[str, ...]
    ) -> None:
        super().__init__(topics, depth=1)
        self._by_stamps = synchronizer(policy, topics)
        self._others = synchronizer(policy, tuple(topic for topic in topics if topic not in steady))
        self._steady: dict[str, list[tuple[int, T]]] = {topic: [] for topic in steady}
        self._alone = 0  # items of the first topic since the last set
        self._holds = False

    @property
    def waiting(self) -> int:
        return self._current.waiting

    def offer(self, topic: str, stamp_ns: int, item: T) -> list[Matched[T]]:
        if topic in self._steady:
            self._steady[topic] = [*self._steady[topic][-1:], (stamp_ns, item)]
            self._hold(holds=False)
        elif topic == next(iter(self._queues)):
            self._alone += 1
            once = all(len(said) == 1 for said in self._steady.values())
            self._hold(holds=once and self._alone > PATIENCE)
        if self._holds:
            found: list[Matched[T]] = self._counted(self._others, topic, stamp_ns, item)
            return [self._completed(matched) for matched in found]
        found = self._counted(self._by_stamps, topic, stamp_ns, item)
        if found:
            self._alone = 0
        return found

    def clear(self) -> None:
        self._hold(holds=False)
        self._by_stamps.clear()
        self._steady = {topic: [] for topic in self._steady}

    @property
    def _current(self) -> Synchronizer[object]:
        return self._others if self._holds else self._by_stamps

    def _hold(self, *, holds: bool) -> None:
        """Go over to the other way to match; what waited for the one is given up."""
        if holds != self._holds:
            self.unmatched += self._current.waiting
            self._current.clear()
            self._holds, self._alone = holds, self._alone * holds

    def _counted(
        self, way: Synchronizer[object], topic: str, stamp_ns: int, item: T
    ) -> list[Matched[T]]:
        before = way.unmatched, way.disordered
        found = way.offer(topic, stamp_ns, item)
        self.unmatched += way.unmatched - before[0]
        self.disordered += way.disordered - before[1]
        return found  # type: ignore[return-value]  # what was put in comes out

    def _completed(self, matched: Matched[T]) -> Matched[T]:
        held = {topic: said[0] for topic, said in self._steady.items()}
        return Matched(items={topic: (matched.items | held)[topic] for topic in self._queues})


class _IndependentSynchronizer(Synchronizer[T]):
    def offer(self, topic: str, stamp_ns: int, item: T) -> list[Matched[T]]:
        """Return the item; the order of stamps does not matter here."""
        return [Matched(items={topic: (stamp_ns, item)})]


def synchronizer(
    policy: SyncPolicy, topics: tuple[str, ...], *, steady: tuple[str, ...] = ()
) -> Synchronizer[object]:
    """Return a policy's queues, led by the first topic; steady ones, not the first, may speak once for all."""
    match policy:
        case Exact() | Approximate() if steady and len(topics) > 1:
            return _SteadySynchronizer(policy, topics, steady)
        case Exact(depth=depth) if len(topics) > 1:
            return _ExactSynchronizer(topics, depth=depth)
        case Approximate(slop_ns=slop_ns, depth=depth) if len(topics) > 1:
            return _ApproximateSynchronizer(topics, depth=depth, slop_ns=slop_ns)
        case Latest() if len(topics) > 1:
            return _LatestSynchronizer(topics, depth=1)
        case _:
            return _IndependentSynchronizer(topics, depth=1)


def _nearest(queue: deque[tuple[int, T]], pivot_ns: int) -> int:
    return min(range(len(queue)), key=lambda index: abs(queue[index][0] - pivot_ns))


def _last_until(queue: deque[tuple[int, T]], pivot_ns: int) -> int:
    return max(index for index, (stamp_ns, _) in enumerate(queue) if stamp_ns <= pivot_ns)


def _check_depth(depth: int) -> None:
    if depth < 1:
        raise InvalidValueError("depth", depth, "whole numbers from 1")
