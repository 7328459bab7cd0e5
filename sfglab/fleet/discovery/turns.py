"""Turns of queries: who is asked next, so that made-up agents, one or a thousand, do not delay a real one.

Who has failed less often comes first, then whoever's publisher has fewer queries before it. When no place is
free, a query that has had its chance gives way to one that has failed no oftener, and is repeated later.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass

#: How long a query holds its place though newcomers wait; one that failed, longer.
CHANCE_NS = 250_000_000
#: The same for one whose service was found: it may be about to answer.
ANSWER_CHANCE_NS = 1_000_000_000
_MAX_DOUBLINGS = 4


@dataclass(slots=True)
class _Query:
    publisher: bytes
    failures: int
    since_ns: int = 0
    chance_ns: int = CHANCE_NS


class Turns:
    """The queries that wait and those under way, of which there are at most so many."""

    def __init__(self, places: int) -> None:
        self._places = places
        self._waiting: list[
            tuple[int, int, int]
        ] = []  # failures, how many of its publisher before it, query
        self._queries: dict[int, _Query] = {}
        self._under_way: dict[int, _Query] = {}
        self._of_publisher: Counter[bytes] = Counter()

    def ask(self, query: int, publisher: bytes, failures: int) -> None:
        """Let a query wait for its turn."""
        self._queries[query] = _Query(publisher, min(failures, _MAX_DOUBLINGS))
        heapq.heappush(
            self._waiting, (min(failures, _MAX_DOUBLINGS), self._of_publisher[publisher], query)
        )
        self._of_publisher[publisher] += 1

    def found(self, query: int, now_ns: int) -> None:
        """Take it that a query has found whom it asks."""
        if (known := self._under_way.get(query)) is not None:
            known.since_ns, known.chance_ns = now_ns, ANSWER_CHANCE_NS

    def ended(self, query: int) -> None:
        """Take it that a query is over, or has been given up; again is harmless."""
        if (known := self._queries.pop(query, None)) is not None:
            self._under_way.pop(query, None)
            self._of_publisher[known.publisher] -= 1
            self._of_publisher += Counter()  # those with none are dropped

    def next(self, now_ns: int) -> tuple[int | None, int | None]:
        """Return the query whose turn it is and the one that makes place for it; None each: none does."""
        while self._waiting and self._waiting[0][2] not in self._queries:
            heapq.heappop(self._waiting)
        if not self._waiting:
            return None, None
        leaves = None
        if len(self._under_way) >= self._places:
            leaves = max(self._under_way, key=self._rank)
            if now_ns < self._until_ns(leaves):
                return None, None
            self.ended(leaves)
        query = heapq.heappop(self._waiting)[2]
        self._under_way[query] = self._queries[query]
        self._under_way[query].since_ns = now_ns
        return query, leaves

    @property
    def deadline_ns(self) -> int | None:
        """When `next` may have more to tell, if nothing ends before; None while nothing waits."""
        if not self._waiting or len(self._under_way) < self._places:
            return None
        return self._until_ns(max(self._under_way, key=self._rank))

    def _rank(self, query: int) -> tuple[int, int]:
        return self._under_way[query].failures, -self._until_ns(query)

    def _until_ns(self, query: int) -> int:
        known = self._under_way[query]
        return known.since_ns + (known.chance_ns << self._waiting[0][0])
