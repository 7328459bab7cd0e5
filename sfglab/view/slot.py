"""Queue between the topics of a display and its visualizer.

At most ``depth`` items of each topic wait for the items of other topics, and at most ``queue`` sets wait to be drawn.
Further items are counted and dropped. A viewer keeps everything that it receives, and has no limit for graphics
memory, so the rate is limited here. The module has no clock: the caller passes stamps, items and the time.
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
    """A set of items that is drawn next."""

    items: dict[str, T]  #: Items by role.
    stamp_ns: int  #: Stamp of the first role's item, ns.
    lost: int  #: Number of sets that were dropped since the set before.


class Slot(Generic[T]):
    """The queue of a visualizer: it matches items of several topics to sets, and limits their rate."""

    def __init__(self, visualizer: Visualizer, max_hz: float | None) -> None:
        #: Rate budget, sets per second; None for no limit. May be changed at any time.
        self.max_hz = max_hz
        self.received = 0  #: Number of received messages.
        self.shown = 0  #: Number of drawn sets; the caller counts them.
        self._budget = RateBudget()
        roles = tuple(visualizer.topics)
        steady = [given.role for given in visualizer.inputs if given.steady and given.role in roles]
        self._synchronizer = Synchronizer[T](visualizer.sync, roles, steady=steady)
        self._ready: deque[Matched[T]] = deque(maxlen=visualizer.queue)
        self._dropped = 0
        self._lost = 0  # sets passed over since the last one taken

    @property
    def waiting(self) -> int:
        """Number of messages that wait for other topics, plus the sets that wait to be drawn."""
        return self._synchronizer.waiting + len(self._ready)

    @property
    def dropped(self) -> int:
        """Number of messages that fit no set, plus the sets that the rate budget or a full queue dropped."""
        return self._synchronizer.unmatched + self._dropped

    def offer(self, role: str, stamp_ns: int, item: T, *, now_ns: int) -> None:
        """Process one message of a role.

        Args:
            role: Input that the message is for.
            stamp_ns: Capture stamp of the message, ns.
            item: The message, in any form.
            now_ns: Present time on the clock of the rate budget, ns.
        """
        self.received += 1
        for matched in self._synchronizer.offer(role, stamp_ns, item):
            if not self._budget.allows(now_ns, self.max_hz):
                self._pass_over(1)
                continue
            if len(self._ready) == self._ready.maxlen:
                self._pass_over(1)
            self._ready.append(matched)

    def interrupt(self) -> None:
        """Drop all sets that wait to be drawn; the next set counts them, and one more, as lost."""
        self._pass_over(len(self._ready))
        self._lost += 1
        self._ready.clear()

    def take(self) -> Taken[T] | None:
        """Remove and return the oldest set; None if no set is ready."""
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
    """Limit of a rate of events, with even gaps; a delay of up to half a period is credited to the next event."""

    def __init__(self) -> None:
        self._due_ns: int | None = None

    def allows(self, now_ns: int, max_hz: float | None) -> bool:
        """Return whether an event passes at a time, ns, given the largest rate, Hz; None for no limit.

        A clock that jumps back resets the budget.
        """
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
