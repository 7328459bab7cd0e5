"""Paper B, Fig. 3 and Fig. 5: what repeats is held back, what changes passes; and what we add to it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp.cache import CacheControl, Decision, LocalCache, exactly_equal, nearly_equal
from sfglab.messages import message_type

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
    cache = LocalCache(max_silence_ns=2 * S)
    assert cache.offer("/b", 1, now_ns=0) is Decision.CHANGED
    for i, value in enumerate([1, 1, 1, 2]):
        cache.offer("/a", value, now_ns=i * S, size_bytes=24)
    counters = cache.counters
    assert (counters.changed, counters.refreshed, counters.held) == (3, 1, 1)
    assert (counters.held_bytes, counters.offered) == (24, 5)


def test_cache_control_keeps_the_value_that_planning_works_with():
    cache = CacheControl()
    assert cache.current("/a") is None
    cache.offer("/a", 1.5, now_ns=0)
    assert cache.offer("/a", 1.5, now_ns=1) is Decision.HELD
    assert cache.current("/a") == 1.5


def test_unsigned_differences_do_not_wrap_around():
    assert nearly_equal(1)(np.array([3], np.uint8), np.array([4], np.uint8))
    assert not nearly_equal(1)(np.array([0], np.uint8), np.array([255], np.uint8))


def test_meaningless_tolerance_and_silence_are_refused():
    for tolerance in (-1, math.nan):
        with pytest.raises(ValueError, match="tolerance"):
            nearly_equal(tolerance)
    with pytest.raises(ValueError, match="max_silence_ns"):
        LocalCache(max_silence_ns=0)


def values(x, count, change):
    """Return a value of each kind that a cache may get, changed by `change` or a known multiple of it."""
    stamp = message_type("builtin_interfaces/msg/Time")(sec=count, nanosec=int(1000 * change))
    return {
        "number": x + change,
        "integer": count + 100 * change,
        "array": np.array([math.nan, x, x + change]),
        "bytes": np.array([count, count + 100 * (change > 0)], np.uint8),
        "list": [1, "a", (x, x + change)],
        "message": message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="a"),
    }


KINDS = list(values(0.0, 1, 0.0))
SEEDS = range(3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_copy_is_equal_and_a_change_is_within_its_size_only(kind, seed):
    """The size of a change is known from how it was made, not from the comparison."""
    rng = np.random.default_rng(seed)
    x, step, count = float(rng.normal()), float(rng.uniform(0.1, 1)), int(rng.integers(1, 100))
    value, copy = values(x, count, 0.0)[kind], values(x, count, 0.0)[kind]
    changed = values(x, count, step)[kind]
    assert exactly_equal(value, copy)
    assert nearly_equal(0.0)(value, copy)
    assert not exactly_equal(value, changed)
    assert not exactly_equal(changed, value)
    largest = 1000 * step  # nanoseconds of the message's stamp
    assert nearly_equal(1.01 * largest)(value, changed)
    assert nearly_equal(1.01 * largest)(changed, value)
    assert not nearly_equal(0.9 * step)(value, changed)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("a", "b"),
        (True, 1),
        (True, False),
        (math.nan, 0.5),
        ([0.5], [0.5, 0.5]),
        ([0.5], (0.5,)),
        (np.zeros(1), np.zeros(1, int)),
        (np.array([0.5]), np.array([0.5, 0.5])),
    ],
)
def test_values_of_different_kinds_or_lengths_are_never_equal(first, second):
    assert not exactly_equal(first, second)
    assert not nearly_equal(9.0)(first, second)


def test_nan_and_infinity_equal_themselves():
    assert exactly_equal(math.nan, float("nan"))
    assert exactly_equal(math.inf, float("inf"))


def test_an_ignored_field_is_not_compared():
    before, after = values(0.5, 1, 0.0)["message"], values(0.5, 1, 0.5)["message"]
    assert nearly_equal(0.0, ignore=frozenset({"stamp"}))(before, after)
