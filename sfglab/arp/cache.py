"""The module `cache` has local cache and cache control; both suppress repeated values before network or planning.

The local cache is in the robot, before the publisher (paper B, section 2.2, Fig. 3). Cache control is in the
station, between subscriber and planning (section 2.3, Fig. 5). Both caches suppress a value that equals the value
before: scalars, strings, NumPy arrays, and messages of `sfglab.messages`, which the caches compare field by field.
A maximum silence is our addition to the paper. After the maximum silence a cache passes a value even if the value
has not changed. Without a maximum silence, the loss of the one message with a change leaves a stale value in the
station indefinitely. Both caches work without I/O and without a clock.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from sfglab.errors import InvalidValueError


def exactly_equal(first: Any, second: Any) -> bool:
    """Return whether two values are equal; NaN equals NaN, and numbers of different types are compared by value."""
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
    """A `Decision` is the decision of a cache on an offered value."""

    #: The value is the first value, or differs from the last passed value: the cache passes the value.
    CHANGED = "changed"
    #: The value is unchanged, and the maximum silence is over: the cache passes the value.
    REFRESHED = "refreshed"
    HELD = "held"  #: The value is unchanged: the cache suppresses the value.

    @property
    def passes(self) -> bool:
        """Whether the cache passes the value."""
        return self is not Decision.HELD


@dataclass(slots=True)
class _Entry:
    value: Any
    passed_ns: int


@dataclass(kw_only=True)
class _ChangeFilter:
    """A `_ChangeFilter` passes a value of a topic if the value has changed."""

    #: Time without a passed value, ns, after which the filter passes an unchanged value; None: never, as in the paper.
    max_silence_ns: int | None = None
    held_bytes: int = 0  #: Size of all suppressed values whose size the caller gave, bytes.
    _entries: dict[str, _Entry] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.max_silence_ns is not None and self.max_silence_ns <= 0:
            raise InvalidValueError(
                "cache max_silence_ns", self.max_silence_ns, "positive nanoseconds or None"
            )

    def offer(self, topic: str, value: Any, *, now_ns: int, size_bytes: int = 0) -> Decision:
        """Decide whether the filter passes a topic's value; the filter remembers a passed value.

        The caller must not change the value after the call. The filter adds `size_bytes` of a suppressed value to
        `held_bytes`.
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
    """A `LocalCache` suppresses repeated sensor values before publication (paper B, section 2.2, Fig. 3)."""


class CacheControl(_ChangeFilter):
    """A `CacheControl` suppresses repeated values in the station before planning (paper B, section 2.3, Fig. 5)."""

    def current(self, topic: str) -> Any:
        """Return the last passed value of a topic, with which planning works; None before the first value."""
        entry = self._entries.get(topic)
        return None if entry is None else entry.value
