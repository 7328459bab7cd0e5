"""Local cache and cache control: both suppress a value that repeats, before the network or before planning.

The local cache is in the robot, before the publisher (paper B, section 2.2, Fig. 3). Cache control is in the
station, between subscriber and planning (section 2.3, Fig. 5). Both have the same rule, "the same value in a
row", for scalars, strings, NumPy arrays and messages of `sfglab.messages`, field by field. A maximum silence goes
beyond the paper. After the maximum silence a value passes although it has not changed; without it, the loss of
the one message with a change leaves a stale value indefinitely. Both work without I/O and without a clock.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from sfglab.errors import InvalidValueError


def exactly_equal(first: Any, second: Any) -> bool:
    """Return whether two values are equal, NaN to NaN, and numbers of different types by their value."""
    if _is_number(first) and _is_number(second):
        return bool(first == second or (np.isnan(first) and np.isnan(second)))
    if type(first) is not type(second):
        return False
    if isinstance(first, np.ndarray):
        has_nan = first.dtype.kind == "f"
        return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=has_nan)
    if dataclasses.is_dataclass(first):
        names = [field.name for field in dataclasses.fields(first)]
        return all(exactly_equal(getattr(first, name), getattr(second, name)) for name in names)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(exactly_equal, first, second))
    return bool(first == second)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


class Decision(Enum):
    """Decision on a value that is offered."""

    CHANGED = "changed"  #: It differs from the last one that passed, or is the first: it passes.
    REFRESHED = "refreshed"  #: It is the same, and the longest silence is over: it passes.
    HELD = "held"  #: It is the same: it is suppressed.

    @property
    def passes(self) -> bool:
        """Whether the value goes on."""
        return self is not Decision.HELD


@dataclass(slots=True)
class _Entry:
    value: Any
    passed_ns: int


@dataclass(kw_only=True)
class _ChangeFilter:
    """Passes a topic's value when it changes."""

    #: After this long without passing anything a topic's value passes anyway; None: never, as in the paper.
    max_silence_ns: int | None = None
    held_bytes: int = 0  #: Size of all values that were suppressed, where the caller gives it.
    _entries: dict[str, _Entry] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.max_silence_ns is not None and self.max_silence_ns <= 0:
            raise InvalidValueError(
                "cache max_silence_ns", self.max_silence_ns, "positive nanoseconds or None"
            )

    def offer(self, topic: str, value: Any, *, now_ns: int, size_bytes: int = 0) -> Decision:
        """Decide whether a topic's value passes, and remember it if so.

        The caller must not change the value afterwards. `size_bytes` is only counted in `held_bytes`.
        """
        decision = self._decide(self._entries.get(topic), value, now_ns)
        if decision.passes:
            self._entries[topic] = _Entry(value, now_ns)
        else:
            self.held_bytes += size_bytes
        return decision

    def _decide(self, entry: _Entry | None, value: Any, now_ns: int) -> Decision:
        if entry is None or not exactly_equal(value, entry.value):
            return Decision.CHANGED
        if self.max_silence_ns is not None and now_ns - entry.passed_ns >= self.max_silence_ns:
            return Decision.REFRESHED
        return Decision.HELD


class LocalCache(_ChangeFilter):
    """Suppresses repeated values of sensors before they are published (paper B, section 2.2, Fig. 3)."""


class CacheControl(_ChangeFilter):
    """Suppresses repeated values in the station before planning (paper B, section 2.3, Fig. 5)."""

    def current(self, topic: str) -> Any:
        """Return the value that planning works with; None before the first."""
        entry = self._entries.get(topic)
        return None if entry is None else entry.value
