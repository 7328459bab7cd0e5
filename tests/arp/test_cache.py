"""Paper B, Fig. 3 and Fig. 5: what repeats is held back, what changes passes; and what we add to it."""

import math
from copy import deepcopy
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp.cache import CacheControl, CacheCounters, LocalCache, exactly_equal
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
    assert cache.current("/a") is None
    for now_ns, (topic, value) in enumerate([("/b", 1), *product(["/a"], [1, 1, 1, 2])]):
        cache.offer(topic, value, now_ns=now_ns, size_bytes=24)
    assert (cache.current("/a"), cache.current("/b")) == (2, 1)
    assert cache.counters == CacheCounters(changed=3, refreshed=1, held=1, held_bytes=24)
    assert cache.counters.offered == 5


def test_a_meaningless_silence_is_refused():
    with pytest.raises(ValueError, match="max_silence_ns"):
        LocalCache(max_silence_ns=0)


def header(nanosec):
    stamp = message_type("builtin_interfaces/msg/Time")(sec=3, nanosec=nanosec)
    return message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="a")


@pytest.mark.parametrize(
    ("value", "other"),
    [
        (0.0, 0.5),
        (0, 200),
        (math.nan, 0.5),
        (math.inf, math.nan),
        ("a", "b"),
        (True, 1),
        (True, False),
        ([1, "a", (0.5, 0)], [1, "a", (0.5, 1)]),
        ([0.5], [0.5, 0.5]),
        ([0.5], (0.5,)),
        (np.array([math.nan, 0.5]), np.array([math.nan, 1.5])),
        (np.array([3, 0], np.uint8), np.array([3, 200], np.uint8)),
        (np.zeros(1), np.zeros(1, int)),
        (np.zeros(1), np.zeros(2)),
        (header(0), header(200)),
    ],
    ids=repr,
)
def test_a_copy_is_equal_and_another_value_length_or_kind_is_not(value, other):
    assert exactly_equal(value, deepcopy(value))
    assert not exactly_equal(value, other)
    assert not exactly_equal(other, value)


def test_numbers_of_different_types_are_equal_by_their_value():
    assert exactly_equal([1, np.float32(0.5), np.float64(math.nan)], [1.0, 0.5, math.nan])
