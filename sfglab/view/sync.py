"""Synchronisation of messages of several topics by exact or approximate time (paper A, section 4.5).

As with ROS 2's message_filters, an item belongs to at most one set, sets come in the order of time, and at most
`depth` items of each topic wait. Items that are dropped without a set are counted, and so are items that are
not newer than the item before on their topic. The module has no clock, and does not read the items.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Sequence

T = TypeVar("T")

PATIENCE = 5
"""Number of items of the first topic without a set, after which single items of steady topics belong to all sets."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Independent:
    """Policy without synchronisation: each message is a set of its own."""

    depth: ClassVar[int] = 1
    slop_ns: ClassVar[int] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Exact:
    """Policy of equal stamps: the messages of a set have the same stamp."""

    depth: int = 10  #: Largest number of items of each topic that wait.
    slop_ns: ClassVar[int] = 0

    def __post_init__(self) -> None:
        _check(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Approximate:
    """Policy of similar stamps: the stamps of a set differ by at most `slop_ns`.

    Each set has a pivot: the latest of the topics' oldest waiting items. The set consists of the pivot and the nearest
    items of the other topics, which are known once these topics have reached the pivot's stamp. A set with different
    stamps is therefore complete with the next item of the topic that is behind, or when a queue is full.
    """

    slop_ns: int = 50_000_000  #: Largest difference between two stamps of a set, in nanoseconds.
    depth: int = 10  #: Largest number of items of each topic that wait.

    def __post_init__(self) -> None:
        _check(self)


def _check(policy: Exact | Approximate) -> None:
    if policy.depth < 1:
        raise InvalidValueError("depth", policy.depth, "whole numbers from 1")
    if policy.slop_ns < 0:
        raise InvalidValueError("slop_ns", policy.slop_ns, "nanoseconds from 0")


SyncPolicy = Independent | Exact | Approximate

Matched = dict[str, tuple[int, T]]
"""A set of items: stamp (ns) and item by topic, the first topic first."""


class Synchronizer(Generic[T]):
    """Queues of several topics, from which a policy makes sets of items.

    Args:
        policy: Policy that decides which items form a set; without effect for one topic.
        topics: Names of the topics.
        steady: Topics with possibly one single item, such as a calibration; not the first topic. After `PATIENCE`
            items of the first topic without a set, such an item belongs to all sets, until the topic has a second one.
    """

    def __init__(
        self, policy: SyncPolicy, topics: tuple[str, ...], *, steady: Sequence[str] = ()
    ) -> None:
        #: Number of dropped items: without a set, or not newer than the item before.
        self.unmatched = 0
        self._policy = Independent() if len(topics) == 1 else policy
        self._leading = topics[0]
        self._all: dict[str, deque[tuple[int, T]]] = {topic: deque() for topic in topics}
        self._queues = self._all  # those that a set needs an item of
        self._last_ns: dict[str, int] = {}
        self._steady: dict[str, list[tuple[int, T]]] = {topic: [] for topic in steady}
        self._held: Matched[T] = {}
        self._alone = 0  # items of the first topic since the last set

    @property
    def waiting(self) -> int:
        """Number of items that wait for items of other topics."""
        return sum(map(len, self._queues.values()))

    def offer(self, topic: str, stamp_ns: int, item: T) -> list[Matched[T]]:
        """Process one item of a topic with its stamp, ns; return the sets that it completes, the oldest first."""
        if isinstance(self._policy, Independent):
            return [{topic: (stamp_ns, item)}]
        if self._steady:
            self._follow_steady(topic, (stamp_ns, item))
        if stamp_ns <= self._last_ns.get(topic, stamp_ns - 1):
            self.unmatched += 1
            return []
        self._last_ns[topic] = stamp_ns
        self._queues[topic].append((stamp_ns, item))
        found = self._matched()
        while len(self._queues[topic]) > self._policy.depth:
            self._drop_oldest(topic)
            found += self._matched()
        if found:
            self._alone = 0
        return found

    def _follow_steady(self, topic: str, stamped: tuple[int, T]) -> None:
        """Decide from the next item whether the single items of steady topics belong to all sets."""
        if topic in self._steady:
            self._steady[topic] = [*self._steady[topic][-1:], stamped]
            if self._held:
                self._held = {}
                self._change_queues(self._all)
        elif topic == self._leading and not self._held:
            self._alone += 1
            said_once = all(len(items) == 1 for items in self._steady.values())
            if said_once and self._alone > PATIENCE:
                self._held = {topic: items[0] for topic, items in self._steady.items()}
                self._change_queues({t: q for t, q in self._all.items() if t not in self._steady})

    def _change_queues(self, queues: dict[str, deque[tuple[int, T]]]) -> None:
        """Require other topics from now on, and drop the waiting items."""
        self.unmatched += self.waiting
        for queue in self._all.values():
            queue.clear()
        self._last_ns.clear()
        self._alone = 0
        self._queues = queues

    def _matched(self) -> list[Matched[T]]:
        """Remove and return the complete sets."""
        found = []
        while all(self._queues.values()):
            pivot_ns = max(queue[0][0] for queue in self._queues.values())
            if self._drop_before(pivot_ns - self._policy.slop_ns):
                continue  # after the drop there is a later pivot
            if not self._is_decided(pivot_ns):
                break
            found.append(self._hand_out(self._best(pivot_ns)))
        return found

    def _is_decided(self, pivot_ns: int) -> bool:
        """Return whether every topic has reached the pivot, or one cannot wait any longer."""
        queues = self._queues.values()
        is_full = any(len(queue) > self._policy.depth for queue in queues)
        return is_full or all(queue[-1][0] >= pivot_ns for queue in queues)

    def _best(self, pivot_ns: int) -> dict[str, int]:
        """Return the index of each topic's nearest item to the pivot, or of the last item not after it.

        The latter are returned if the nearest items are too far apart.
        """
        nearest = {topic: _nearest(queue, pivot_ns) for topic, queue in self._queues.items()}
        stamps = [self._queues[topic][index][0] for topic, index in nearest.items()]
        if max(stamps) - min(stamps) <= self._policy.slop_ns:
            return nearest
        return {topic: _last_until(queue, pivot_ns) for topic, queue in self._queues.items()}

    def _hand_out(self, indexes: dict[str, int]) -> Matched[T]:
        """Remove one item of each queue with all older ones, and return the set."""
        items = dict(self._held)
        for topic, index in indexes.items():
            for _ in range(index):
                self._drop_oldest(topic)
            items[topic] = self._queues[topic].popleft()
        return {topic: items[topic] for topic in self._all}

    def _drop_oldest(self, topic: str) -> None:
        self._queues[topic].popleft()
        self.unmatched += 1

    def _drop_before(self, stamp_ns: int) -> bool:
        """Drop the items before a stamp; return whether there were any."""
        unmatched = self.unmatched
        for topic, queue in self._queues.items():
            while queue and queue[0][0] < stamp_ns:
                self._drop_oldest(topic)
        return self.unmatched > unmatched


def _nearest(queue: deque[tuple[int, T]], pivot_ns: int) -> int:
    return min(range(len(queue)), key=lambda index: abs(queue[index][0] - pivot_ns))


def _last_until(queue: deque[tuple[int, T]], pivot_ns: int) -> int:
    return max(index for index, (stamp_ns, _) in enumerate(queue) if stamp_ns <= pivot_ns)
