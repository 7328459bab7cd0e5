"""Queue between the topics of a display and its visualizer.

At most ``depth`` items of each topic wait for their partners, and at most ``queue`` sets for their turn. Others
are counted and dropped. A viewer keeps all that it receives, and no limit of the viewer covers graphics memory;
so the rate is limited here. Pure: stamps and opaque items in, sets out, the clock is the caller's.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from sfglab.errors import InvalidValueError
from sfglab.units import NS_PER_S
from sfglab.view.sync import Matched, Synchronizer, SyncPolicy

if TYPE_CHECKING:
    from collections.abc import Mapping

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """Counts of the messages of a slot."""

    received: int  #: Messages offered.
    shown: int  #: Sets drawn.
    waiting: int  #: Messages that wait for partners and sets that wait for their turn.
    unmatched: int  #: Messages without partners, or out of order.
    over_budget: int  #: Sets that the rate budget stopped.
    #: Sets that a newer one pushed out of the queue, or that waited when it was switched off.
    pushed_out: int

    @property
    def dropped(self) -> int:
        """Everything that was not shown and does not wait."""
        return self.unmatched + self.over_budget + self.pushed_out


class Taken(NamedTuple, Generic[T]):
    """A set whose turn has come."""

    items: dict[str, T]  #: By role.
    stamp_ns: int  #: Stamp of the leading item.
    lost: int  #: Sets passed over since the one before.


class Slot(Generic[T]):
    """The queue of a visualizer's sets; the first role leads, a message of steady ones may hold for good."""

    def __init__(
        self,
        roles: tuple[str, ...],
        *,
        policy: SyncPolicy,
        max_hz: float | None,
        queue: int,
        steady: tuple[str, ...] = (),
    ) -> None:
        self.budget = RateBudget(max_hz)  #: May be changed at any time.
        self._synchronizer = Synchronizer[T](policy, roles, steady=steady)
        self._ready: deque[Matched[T]] = deque(maxlen=queue)
        self._received = self._shown = self._pushed_out = self._passed_over = 0

    def offer(self, role: str, stamp_ns: int, item: T, *, now_ns: int) -> None:
        """Take one message of a role, in any form, with its capture stamp; now is by the budget's clock."""
        self._received += 1
        for matched in self._synchronizer.offer(role, stamp_ns, item):
            if not self.budget.allows(now_ns):
                self._passed_over += 1
                continue
            if len(self._ready) == self._ready.maxlen:
                self._pushed_out += 1
                self._passed_over += 1
            self._ready.append(matched)

    def interrupt(self) -> None:
        """Let go of what waits; messages are kept from here, so the next update says that some are lost."""
        self._pushed_out += len(self._ready)
        self._passed_over += 1 + len(self._ready)
        self._ready.clear()

    def take(self) -> Taken[T] | None:
        """Remove and return the oldest set, None when none is ready."""
        if not self._ready:
            return None
        matched = self._ready.popleft()
        lost, self._passed_over = self._passed_over, 0
        items: Mapping[str, tuple[int, T]] = matched.items
        return Taken({role: item for role, (_, item) in items.items()}, matched.stamp_ns, lost)

    def count_shown(self) -> None:
        """Take note that the set taken last was drawn."""
        self._shown += 1

    def __len__(self) -> int:
        return len(self._ready)

    @property
    def counts(self) -> Counts:
        """Counts up to now."""
        return Counts(
            received=self._received,
            shown=self._shown,
            waiting=self._synchronizer.waiting + len(self._ready),
            unmatched=self._synchronizer.unmatched + self._synchronizer.disordered,
            over_budget=self.budget.dropped,
            pushed_out=self._pushed_out,
        )


class RateBudget:
    """Lets `max_hz` events a second pass evenly, half a period late credited to the next; None: everything."""

    def __init__(self, max_hz: float | None) -> None:
        self.dropped = 0  #: Events that did not pass.
        self._max_hz: float | None = None
        self._next_ns: int | None = None
        self.max_hz = max_hz

    @property
    def max_hz(self) -> float | None:
        """Events a second; None lets everything pass. May be changed at any time."""
        return self._max_hz

    @max_hz.setter
    def max_hz(self, value: float | None) -> None:
        if value is not None and not 0 < value < float("inf"):
            raise InvalidValueError("max_hz", value, "positive numbers, or None for no limit")
        self._max_hz, self._next_ns = value, None

    def allows(self, now_ns: int) -> bool:
        """Return whether an event passes now, otherwise count it as dropped. A clock that jumps back resets the budget."""
        if self._max_hz is None:
            return True
        period_ns = round(NS_PER_S / self._max_hz)
        due_ns = self._next_ns
        if due_ns is None or now_ns < due_ns - 2 * period_ns:
            due_ns = now_ns
        elif now_ns < due_ns - period_ns // 4:
            self.dropped += 1
            return False
        self._next_ns = max(due_ns, now_ns - period_ns // 2) + period_ns
        return True
