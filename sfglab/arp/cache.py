"""Local cache and cache control: both suppress a value that repeats, before the network or before planning.

The local cache is in the robot, before the publisher (paper B, section 2.2, Fig. 3). Cache control is in the
station, between subscriber and planning (section 2.3, Fig. 5). Both have the same rule, "the same value in a
row", for scalars, strings, NumPy arrays and messages of `sfglab.messages`, field by field. A tolerance and a maximum silence go
beyond the paper. After the maximum silence a value passes although it has not changed; without it, the loss of
the one message with a change leaves a stale value indefinitely. Both work without I/O and without a clock.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Any

import numpy as np

from sfglab.errors import InvalidValueError

Equality = Callable[[Any, Any], bool]


def exactly_equal(first: Any, second: Any, *, ignore: frozenset[str] = frozenset()) -> bool:
    """Return whether two values are equal, NaN to NaN, without the fields `ignore`, such as ``header``."""
    return _equal(first, second, 0.0, ignore)


def nearly_equal(tolerance: float, *, ignore: frozenset[str] = frozenset()) -> Equality:
    """Return a comparison that takes numbers for equal that differ by no more than a tolerance, in their unit.

    Texts and truth values stay exact. A tolerance below 0 is an InvalidValueError.
    """
    if not tolerance >= 0.0:
        raise InvalidValueError("cache tolerance", tolerance, "0 and more")
    return partial(_equal, tolerance=tolerance, ignore=ignore)


def _equal(first: Any, second: Any, tolerance: float, ignore: frozenset[str]) -> bool:
    if type(first) is not type(second):
        return _is_number(first) and _is_number(second) and _numbers_equal(first, second, tolerance)
    if dataclasses.is_dataclass(first):
        fields = (f.name for f in dataclasses.fields(first) if f.name not in ignore)
        return all(_equal(getattr(first, n), getattr(second, n), tolerance, ignore) for n in fields)
    if isinstance(first, (list, tuple)):
        return len(first) == len(second) and all(
            _equal(a, b, tolerance, ignore) for a, b in zip(first, second, strict=True)
        )
    if isinstance(first, np.ndarray):
        return (
            first.shape == second.shape
            and first.dtype == second.dtype
            and _arrays_equal(first, second, tolerance)
        )
    if _is_number(first):
        return _numbers_equal(first, second, tolerance)
    return bool(first == second)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _numbers_equal(first: Any, second: Any, tolerance: float) -> bool:
    # Infinities are equal to themselves, and their difference is no number.
    return bool(
        first == second
        or abs(first - second) <= tolerance
        or (np.isnan(first) and np.isnan(second))
    )


def _arrays_equal(first: Any, second: Any, tolerance: float) -> bool:
    if first.dtype.kind not in "iuf" or tolerance == 0.0:
        return bool(np.array_equal(first, second, equal_nan=first.dtype.kind == "f"))
    # Unsigned differences would wrap around.
    return bool(
        np.allclose(
            first.astype(np.float64),
            second.astype(np.float64),
            rtol=0.0,
            atol=tolerance,
            equal_nan=True,
        )
    )


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
class CacheCounters:
    """Counts of a cache's decisions."""

    changed: int = 0  #: Values that passed because they differed.
    refreshed: int = 0  #: Values that passed because the silence had lasted long enough.
    held: int = 0  #: Values that were suppressed.
    held_bytes: int = 0  #: Their size, where the caller gives it.

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

    equal: Equality = exactly_equal  #: Comparison of two values; exact by default.
    #: After this long without passing anything a topic's value passes anyway; None: never, as in the paper.
    max_silence_ns: int | None = None
    #: Counts of all topics together.
    counters: CacheCounters = field(default_factory=CacheCounters)
    _entries: dict[str, _Entry] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.max_silence_ns is not None and self.max_silence_ns <= 0:
            raise InvalidValueError(
                "cache max_silence_ns", self.max_silence_ns, "positive nanoseconds or None"
            )

    def offer(self, topic: str, value: Any, *, now_ns: int, size_bytes: int = 0) -> Decision:
        """Decide whether a topic's value passes, and remember it if so.

        The last value that passed is compared, so a slow drift passes once it exceeds the tolerance. The
        caller must not change the value afterwards. `size_bytes` is only counted in `held_bytes`.
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

    def _decide(self, entry: _Entry | None, value: Any, now_ns: int) -> Decision:
        if entry is None or not self.equal(value, entry.value):
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
