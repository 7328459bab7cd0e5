"""Paper B, Fig. 3 and Fig. 5: what repeats is held back, what changes passes; and what we add to it."""

import math
from copy import deepcopy
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp.cache import CacheControl, LocalCache, exactly_equal
from sfglab.messages import message_type


@given(
    st.lists(st.sampled_from([0.0, 1.0, 2.5, math.nan, math.inf])), st.none() | st.integers(1, 5)
)
def test_exactly_changes_pass_and_a_value_whose_silence_has_lasted_long_enough(values, silence_ns):
    cache, last, passed_ns = LocalCache(max_silence_ns=silence_ns), "", 0
    for now_ns, value in enumerate(values):
        passes = repr(value) != last or now_ns - passed_ns >= (silence_ns or math.inf)
        assert cache.offer("/a", value, now_ns=now_ns).passes == passes
        if passes:
            last, passed_ns = repr(value), now_ns


def test_topics_have_values_of_their_own_and_the_bytes_that_are_held_are_counted():
    cache = CacheControl(max_silence_ns=2)
    assert cache.current("/a") is None
    for now_ns, (topic, value) in enumerate([("/b", 1), *product(["/a"], [1, 1, 1, 2])]):
        cache.offer(topic, value, now_ns=now_ns, size_bytes=24)
    assert (cache.current("/a"), cache.current("/b")) == (2, 1)
    assert cache.held_bytes == 24


def test_a_meaningless_silence_is_refused():
    with pytest.raises(ValueError, match="max_silence_ns"):
        LocalCache(max_silence_ns=0)


def header(nanosec):
    stamp = message_type("builtin_interfaces/msg/Time")(sec=3, nanosec=nanosec)
    return message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="a")


@pytest.mark.parametrize(
    ("value", "other"),
    [
        (math.nan, 0.5),
        (True, 1),
        ([1, "a", (0.5, 0)], [1, "a", (0.5, 1)]),
        ([0.5], [0.5, 0.5]),
        ([0.5], (0.5,)),
        (np.array([math.nan, 0.5]), np.array([math.nan, 1.5])),
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
