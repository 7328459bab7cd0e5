"""Paper B, Fig. 3 and Fig. 5: what repeats is held back, what changes passes; and what we add to it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp.cache import CacheControl, Decision, LocalCache, exactly_equal, nearly_equal
from sfglab.messages import default_message, message_type, stamp_from_ns

S = 1_000_000_000


@given(st.lists(st.sampled_from([0.0, 1.0, 2.5, math.nan, math.inf])))
def test_exactly_the_changes_pass(values):
    changes = [v for i, v in enumerate(values) if i == 0 or not exactly_equal(v, values[i - 1])]
    cache = LocalCache()
    passed = [v for i, v in enumerate(values) if cache.offer("/a", v, now_ns=i * S).passes]
    assert [repr(v) for v in passed] == [repr(v) for v in changes]


@given(st.lists(st.integers(0, 3)), st.integers(1, 5))
def test_no_silence_is_longer_than_allowed(values, silence_s):
    cache = LocalCache(max_silence_ns=silence_s * S)
    times = [i for i, v in enumerate(values) if cache.offer("/a", v, now_ns=i * S).passes]
    assert all(b - a <= silence_s for a, b in pairwise(times))


@given(st.lists(st.floats(-5, 5)), st.floats(0, 1))
def test_a_drift_never_goes_further_than_the_tolerance_unseen(values, tolerance):
    cache = LocalCache(equal=nearly_equal(tolerance))
    last = None
    for i, value in enumerate(values):
        if cache.offer("/a", value, now_ns=i).passes:
            last = value
        assert abs(value - last) <= tolerance


def test_topics_do_not_influence_each_other_and_counters_count_messages_and_bytes():
    cache = LocalCache()
    assert cache.offer("/a", 1, now_ns=0) is Decision.CHANGED
    assert cache.offer("/b", 1, now_ns=0) is Decision.CHANGED
    assert cache.offer("/a", 1, now_ns=1) is Decision.HELD
    cache = LocalCache(max_silence_ns=2 * S)
    for i, value in enumerate([1, 1, 1, 2]):
        cache.offer("/a", value, now_ns=i * S, size_bytes=24)
    counters = cache.counters
    assert (counters.changed, counters.refreshed, counters.held) == (2, 1, 1)
    assert counters.held_bytes == 24
    assert counters.offered == 4


def test_cache_control_keeps_the_value_that_planning_works_with():
    cache = CacheControl()
    assert cache.current("/a") is None
    cache.offer("/a", 1.5, now_ns=0)
    assert cache.offer("/a", 1.5, now_ns=1) is Decision.HELD
    assert cache.current("/a") == 1.5


def lidar(ranges, stamp_ns):
    scan = default_message("sensor_msgs/msg/LaserScan")
    scan.header.stamp, scan.header.frame_id = stamp_from_ns(stamp_ns), "laser"
    scan.angle_max, scan.angle_increment, scan.scan_time, scan.range_max = 1.0, 0.1, 0.1, 9.0
    scan.ranges = np.asarray(ranges, np.float32)
    return scan


def test_messages_are_compared_field_by_field_and_a_header_may_be_left_out():
    first, second = lidar([1, 2, math.nan], 0), lidar([1, 2, math.nan], S)
    assert not exactly_equal(first, second)
    assert exactly_equal(first, second, ignore=frozenset({"header"}))
    assert not exactly_equal(first, lidar([1, 2], S), ignore=frozenset({"header"}))
    near = nearly_equal(0.1, ignore=frozenset({"header"}))
    assert near(first, lidar([1.05, 2, math.nan], 0))
    assert not near(first, lidar([1.2, 2, math.nan], 0))


def test_unsigned_differences_do_not_wrap_around_and_text_truth_and_number_are_different_things():
    assert nearly_equal(1)(np.array([3], np.uint8), np.array([4], np.uint8))
    assert not nearly_equal(1)(np.array([0], np.uint8), np.array([255], np.uint8))
    assert exactly_equal("detect", "detect")
    assert not exactly_equal(True, 1)
    assert exactly_equal(1, 1.0)
    assert not nearly_equal(5)(True, False)


def test_meaningless_tolerance_and_silence_are_refused():
    for tolerance in (-1, math.nan):
        with pytest.raises(ValueError, match="tolerance"):
            nearly_equal(tolerance)
    with pytest.raises(ValueError, match="max_silence_ns"):
        LocalCache(max_silence_ns=0)


def compared(rng):
    """Yield for drawn values of each kind whether a copy is the same, a change none, and a tolerance respected.

    The sizes of changes are known by how they were made, not by the comparison.
    """
    for _ in range(20):
        x, step, count = float(rng.normal()), float(rng.uniform(0.1, 1)), int(rng.integers(1, 100))
        nan, far = float("nan"), 1000 * step
        same, copies, changed = (kinds(x, count, d) for d in (0.0, 0.0, step))
        for kind, one in same.items():
            copy, other = copies[kind], changed[kind]
            yield f"{kind}: copy", exactly_equal(one, copy) and nearly_equal(0.0)(one, copy)
            yield f"{kind}: change", not exactly_equal(one, other) and not exactly_equal(other, one)
            within = nearly_equal(1.01 * far)
            yield f"{kind}: within", within(one, other) and within(other, one)
            yield f"{kind}: beyond", not nearly_equal(0.9 * step)(one, other)
        pairs = [("a", "b"), (True, 1), (True, False), (x, "a"), (nan, x)]
        pairs += [([x], [x, x]), ([x], (x,)), (np.zeros(1), np.zeros(1, int))]
        pairs.append((np.array([x]), np.array([x, x])))
        for first, second in pairs:
            alike = exactly_equal(first, second) or nearly_equal(9.0)(first, second)
            yield f"{first!r} and {second!r}", not alike
        yield (
            "no number",
            exactly_equal(nan, float("nan")) and exactly_equal(float("inf"), float("inf")),
        )
        yield (
            "ignored",
            nearly_equal(0.0, ignore=frozenset({"stamp"}))(same["message"], changed["message"]),
        )


def kinds(x, count, d):
    """Return a value of each kind that a cache may be offered, changed by `d` or a known multiple of it."""
    stamp = message_type("builtin_interfaces/msg/Time")(sec=count, nanosec=int(1000 * d))
    return {
        "number": x + d,
        "integer": count + 100 * d,
        "array": np.array([float("nan"), x, x + d]),
        "bytes": np.array([count, count + 100 * (d > 0)], np.uint8),
        "list": [1, "a", (x, x + d)],
        "message": message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="a"),
    }


def test_values_of_each_kind_are_the_same_to_the_bit_or_within_the_tolerance():
    wrong = [case for case, holds in compared(np.random.default_rng(0)) if not holds]
    assert wrong == []
