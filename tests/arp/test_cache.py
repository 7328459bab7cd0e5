"""Paper B, Fig. 3 and Fig. 5: what repeats is held back, what changes passes; and what we add to it."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp.cache import CacheControl, Decision, LocalCache, exactly_equal
from sfglab.messages import message_type


@given(st.lists(st.sampled_from([0.0, 1.0, 2.5, math.nan, math.inf])))
def test_exactly_the_changes_pass(values):
    cache = LocalCache()
    passed = [cache.offer("/a", value, now_ns=0).passes for value in values]
    texts = [repr(value) for value in values]
    assert passed == [a != b for a, b in pairwise([None, *texts])]


@given(st.lists(st.integers(0, 3)), st.integers(1, 5))
def test_no_silence_is_longer_than_allowed(values, silence_ns):
    cache = LocalCache(max_silence_ns=silence_ns)
    times = [i for i, v in enumerate(values) if cache.offer("/a", v, now_ns=i).passes]
    assert all(b - a <= silence_ns for a, b in pairwise(times))


def test_topics_have_values_of_their_own_and_counters_count_messages_and_bytes():
    cache = CacheControl(max_silence_ns=2)
    assert cache.current("/b") is None
    assert cache.offer("/b", 1, now_ns=0) is Decision.CHANGED
    for now_ns, value in enumerate([1, 1, 1, 2]):
        cache.offer("/a", value, now_ns=now_ns, size_bytes=24)
    assert (cache.current("/a"), cache.current("/b")) == (2, 1)
    counters = cache.counters
    assert (counters.changed, counters.refreshed, counters.held) == (3, 1, 1)
    assert (counters.held_bytes, counters.offered) == (24, 5)


def test_a_meaningless_silence_is_refused():
    with pytest.raises(ValueError, match="max_silence_ns"):
        LocalCache(max_silence_ns=0)


def header(nanosec):
    stamp = message_type("builtin_interfaces/msg/Time")(sec=3, nanosec=nanosec)
    return message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="a")


# Each kind of value that a cache may get, as a function of one number.
KINDS = {
    "number": lambda x: x / 2,
    "integer": lambda x: x,
    "array": lambda x: np.array([math.nan, 0.5, x]),
    "unsigned bytes": lambda x: np.array([3, x], np.uint8),
    "list": lambda x: [1, "a", (0.5, x)],
    "message": header,
    "NaN": lambda x: x or math.nan,
    "infinity": lambda x: x or math.inf,
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_copy_is_equal_and_a_change_is_not(kind):
    value, copy, changed = (KINDS[kind](x) for x in (0, 0, 200))
    assert exactly_equal(value, copy)
    assert not exactly_equal(value, changed)
    assert not exactly_equal(changed, value)


def test_numbers_of_different_types_are_equal_by_their_value():
    assert exactly_equal(1, 1.0)
    assert exactly_equal(np.float32(0.5), 0.5)
    assert exactly_equal([np.float64(math.nan)], [math.nan])


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
