"""The memory model: cycles, turns at the interface, transfer times and break-even sizes."""

import itertools
from dataclasses import replace
from statistics import fmean

import pytest
from graph_strategies import HW, SW
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.soc import TopicMapping
from sfglab.soc.memory import (
    STORED,
    MemoryInterface,
    Setup,
    round_robin_s,
    shared_s,
    transfer_times,
)
from sfglab.soc.paper_values import MESSAGE_BYTES

MEMIF = MemoryInterface()
SIDES = st.sampled_from([SW, HW])


def setup(publisher=HW, mapping=TopicMapping.SOFTWARE, size=1_000_000, hardware=4, software=1):
    nodes = {"hardware_subscribers": hardware, "software_subscribers": software}
    return Setup(publisher=publisher, mapping=mapping, message_bytes=size, **nodes)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 400), min_size=1, max_size=8), st.integers(1, 40))
def test_the_last_of_several_nodes_ends_with_the_busy_period_whatever_the_turns(releases, chunks):
    ends = round_robin_s(releases, chunks, 1.0)
    assert max(ends) == pytest.approx(shared_s(releases, chunks))
    assert all(end >= release + chunks for end, release in zip(ends, releases, strict=True))


@pytest.mark.parametrize("size", MESSAGE_BYTES)
@pytest.mark.parametrize(("hardware", "software"), [(1, 1), (4, 1), (8, 1), (3, 3), (5, 0)])
def test_mean_places_stand_for_all_orders_of_deliveries(hardware, software, size):
    found = transfer_times(setup(SW, TopicMapping.SOFTWARE, size, hardware, software))
    orders = itertools.combinations(range(1, hardware + software + 1), hardware)
    each_s, read_s = STORED.delivery_s(size), STORED.read_s(size)
    exact_s = fmean(shared_s([place * each_s for place in order], read_s) for order in orders)
    fixed_s = STORED.published_s(size) + STORED.delegate_s + STORED.endpoint_s
    # Without a software subscriber there is only one order of places.
    assert found[HW] == pytest.approx(fixed_s + exact_s, rel=0.005 if software else 1e-9)


@pytest.mark.parametrize("publisher", [SW, HW])
def test_a_gateway_costs_the_cancellation_and_no_more_for_more_hardware_subscribers(publisher):
    few, many = (setup(publisher, TopicMapping.GATEWAY, hardware=n) for n in (2, 8))
    assert transfer_times(few) == transfer_times(many)
    free_s = transfer_times(few, replace(STORED, cancel_s=0.0))[SW]
    cancel_s = STORED.cancel_s if publisher is HW else 0.0
    assert transfer_times(few)[SW] - free_s == pytest.approx(cancel_s)


def test_software_on_a_hardware_mapped_topic_is_refused():
    with pytest.raises(InvalidValueError, match="only hardware nodes"):
        setup(HW, TopicMapping.HARDWARE)
