from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.messages import MessageError, ns_from_stamp, stamp_from_ns


@given(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
def test_stamps_are_exact_to_the_nanosecond(stamp_ns):
    stamp = stamp_from_ns(stamp_ns)
    assert 0 <= stamp.nanosec < 10**9
    assert ns_from_stamp(stamp) == stamp_ns


@pytest.mark.parametrize("stamp_ns", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_a_time_beyond_32_bit_seconds_is_refused(stamp_ns):
    with pytest.raises(MessageError, match=f"given {stamp_ns} ns.*int32"):
        stamp_from_ns(stamp_ns)
