"""The event heap: earliest first, equal times in the order of insertion, kinds and arguments as they were."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.rtps.state import Event
from sfglab.rtps.world import new_heap, pop, push

events = st.lists(
    st.tuples(
        st.integers(0, 5) | st.integers(0, 2**62),
        st.sampled_from([int(kind) for kind in Event]),
        st.integers(0, 2**20 - 1),
    ),
    min_size=1,
    max_size=200,
)


@settings(deadline=None)  # the first example compiles
@given(events, events | st.just([]))
def test_events_come_out_by_time_and_then_as_they_went_in_also_those_that_come_in_between(first, second):
    slots, sizes = new_heap(len(first) + len(second))
    for event in first:
        push(slots, sizes, *event)
    earliest = pop(slots, sizes)
    rest = sorted(first, key=lambda event: event[0])[1:]
    for event in second:
        push(slots, sizes, *event)
    out = [pop(slots, sizes) for _ in range(sizes[0])]
    assert earliest == min(first, key=lambda event: event[0])
    assert out == sorted(rest + second, key=lambda event: event[0]), "sorting is stable"
    assert sizes[0] == 0


def test_a_full_heap_says_so():
    slots, sizes = new_heap(1)
    push(slots, sizes, 1, 0, 0)
    with pytest.raises(IndexError, match="full"):
        push(slots, sizes, 2, 0, 0)
