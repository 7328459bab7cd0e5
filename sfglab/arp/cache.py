"""Local cache and cache control: a value that repeats is held back once, before the network or before planning.

The local cache stands in the robot, before the publisher (paper B, section 2.2, Fig. 3); cache control stands
in the station, between the subscriber and planning (section 2.3, Fig. 5). Both are the same rule at another
boundary. Beyond the paper: a tolerance, and a longest silence after which a value passes although it has not
changed. Without it, the loss of the one message that carried a change leaves a stale value for ever, and who
joins late knows nothing. Pure: values and `now_ns` in, a decision out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.arp.equality import exactly_equal

if TYPE_CHECKING:
    from sfglab.arp.equality import Equality


class Decision(Enum):
    """What happens to a value that is offered."""

    CHANGED = "changed"
    """It differs from the last one that passed, or is the first: it passes."""
    REFRESHED = "refreshed"
    """It is the same, and the longest silence is over: it passes."""
    HELD = "held"
    """It is the same: it is held back."""

    @property
    def passes(self) -> bool:
        """Whether the value goes on."""
        return self is not Decision.HELD


@dataclass(slots=True)
class CacheCounters:
    """What a cache has done."""

    changed: int = 0  #: Values that passed because they differed.
    refreshed: int = 0  #: Values that passed because the silence had lasted long enough.
    held: int = 0  #: Values that were held back.
    held_bytes: int = 0  #: Their size, where the caller says it.

    @property
    def offered(self) -> int:
        """All values that were offered."""
        return self.changed + self.refreshed + self.held


@dataclass(slots=True)
class _Entry:
    value: Any
    passed_ns: int


@dataclass(kw_only=True)
class _ChangeFilter:
    """Passes a topic's value when it changes."""

    equal: Equality = exactly_equal  #: When two values are the same; exact by default.
    #: After this long without passing anything a topic's value passes anyway; None: never, as in the paper.
    max_silence_ns: int | None = None
    #: What it has done, for all topics together.
    counters: CacheCounters = field(default_factory=CacheCounters)
    _entries: dict[str, _Entry] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.max_silence_ns is not None and self.max_silence_ns <= 0:
            raise ValueError(
                f"cache max_silence_ns: given {self.max_silence_ns}, allowed are positive nanoseconds or None"
            )

    def offer(self, topic: str, value: Any, *, now_ns: int, size_bytes: int = 0) -> Decision:
        """Decide on one value, and remember it if it passes.

        Args:
            topic: Whose value it is; topics do not influence each other.
            value: The value; it must not be changed afterwards.
            now_ns: The caller's clock, nanoseconds.
            size_bytes: What passing it would cost, for the counters.
        """
        entry = self._entries.get(topic)
        decision = self._decide(entry, value, now_ns)
        if decision is Decision.HELD:
            self.counters.held += 1
            self.counters.held_bytes += size_bytes
            return decision
        self._entries[topic] = _Entry(value, now_ns)
        if decision is Decision.CHANGED:
            self.counters.changed += 1
        else:
            self.counters.refreshed += 1
        return decision

    def forget(self, topic: str) -> None:
        """Let the next value of a topic pass, as when a new subscriber appears."""
        self._entries.pop(topic, None)

    def _decide(self, entry: _Entry | None, value: Any, now_ns: int) -> Decision:
        if entry is None or not self.equal(value, entry.value):
            return Decision.CHANGED
        if self.max_silence_ns is not None and now_ns - entry.passed_ns >= self.max_silence_ns:
            return Decision.REFRESHED
        return Decision.HELD


class LocalCache(_ChangeFilter):
    """In the robot, between sensor and publisher: paper B, section 2.2, Fig. 3."""


class CacheControl(_ChangeFilter):
    """In the station, between subscriber and planning: paper B, section 2.3, Fig. 5."""

    def current(self, topic: str) -> Any:
        """Return the value that planning works with; None before the first."""
        entry = self._entries.get(topic)
        return None if entry is None else entry.value
