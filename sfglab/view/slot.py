"""Queue between the topics of a display and its visualizer.

At most ``depth`` items of each topic wait for their partners, and at most ``queue`` sets for their turn. Others
are counted and dropped. A viewer keeps all that it receives, and no limit of the viewer covers graphics memory;
so the rate is limited here. Pure: stamps and opaque items in, sets out, the clock is the caller's.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from sfglab.units import NS_PER_S
from sfglab.view.sync import Matched, Synchronizer

if TYPE_CHECKING:
    from sfglab.view.visualizer import Visualizer

T = TypeVar("T")


class Taken(NamedTuple, Generic[T]):
    """A set whose turn has come."""

    items: dict[str, T]  #: By role.
    stamp_ns: int  #: Stamp of the leading item.
    lost: int  #: Sets passed over since the one before.


class Slot(Generic[T]):
    """The queue of a visualizer's sets."""

    def __init__(self, visualizer: Visualizer, max_hz: float | None) -> None:
        #: Rate budget, sets per second; None for no limit. May be changed at any time.
        self.max_hz = max_hz
        self.received = 0  #: Messages offered.
        self.shown = 0  #: Sets drawn, as the caller counts them.
        self._budget = RateBudget()
        roles = tuple(visualizer.topics)
        steady = [given.role for given in visualizer.inputs if given.steady and given.role in roles]
        self._synchronizer = Synchronizer[T](visualizer.sync, roles, steady=steady)
        self._ready: deque[Matched[T]] = deque(maxlen=visualizer.queue)
        self._dropped = 0
        self._lost = 0  # sets passed over since the last one taken

    @property
    def waiting(self) -> int:
        """Messages that wait for partners and sets that wait for their turn."""
        return self._synchronizer.waiting + len(self._ready)

    @property
    def dropped(self) -> int:
        """Messages without partners, and sets that the rate budget or a full queue stopped."""
        return self._synchronizer.unmatched + self._dropped

    def offer(self, role: str, stamp_ns: int, item: T, *, now_ns: int) -> None:
        """Take one message of a role, in any form, with its capture stamp; now is by the budget's clock."""
        self.received += 1
        for matched in self._synchronizer.offer(role, stamp_ns, item):
            if not self._budget.allows(now_ns, self.max_hz):
                self._pass_over(1)
                continue
            if len(self._ready) == self._ready.maxlen:
                self._pass_over(1)
            self._ready.append(matched)

    def interrupt(self) -> None:
        """Let go of what waits; messages are kept from here, so the next update says that some are lost."""
        self._pass_over(len(self._ready))
        self._lost += 1
        self._ready.clear()

    def take(self) -> Taken[T] | None:
        """Remove and return the oldest set, None when none is ready."""
        if not self._ready:
            return None
        matched = self._ready.popleft()
        lost, self._lost = self._lost, 0
        items = {role: item for role, (_, item) in matched.items()}
        stamp_ns, _ = next(iter(matched.values()))
        return Taken(items, stamp_ns, lost)

    def _pass_over(self, count: int) -> None:
        self._dropped += count
        self._lost += count


class RateBudget:
    """Lets events pass evenly; half a period late is credited to the next one."""

    def __init__(self) -> None:
        self._due_ns: int | None = None

    def allows(self, now_ns: int, max_hz: float | None) -> bool:
        """Return whether an event passes now; without a rate each does. A clock that jumps back resets the budget."""
        if max_hz is None:
            return True
        period_ns = round(NS_PER_S / max_hz)
        due_ns = self._due_ns
        if due_ns is None or now_ns < due_ns - 2 * period_ns:
            due_ns = now_ns
        elif now_ns < due_ns - period_ns // 4:
            return False
        self._due_ns = max(due_ns, now_ns - period_ns // 2) + period_ns
        return True
