"""Transfer times over topics in software, in hardware and over gateways (paper C, section 4, Fig. 5)."""

from __future__ import annotations

import itertools
from dataclasses import replace
from statistics import fmean

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.soc.memory import (
    CUT_THROUGH,
    MESSAGE_BYTES,
    STORED,
    MemoryInterfaceError,
    Setup,
    Side,
    Times,
    Transport,
    round_robin_s,
    shared_s,
    transfer_times,
)

BOTH = pytest.mark.parametrize("costs", [STORED, CUT_THROUGH], ids=["stored", "cut-through"])


def times(publisher: Side, transport: Transport, size: int = 1_000_000, costs=STORED, **nodes: int) -> Times:
    setup = {"hardware": 4, **nodes}
    return transfer_times(Setup(publisher=publisher, transport=transport, message_bytes=size, **setup), costs)


def delivery_s(size: int, costs) -> float:
    return costs.deliver_s + size * costs.deliver_s_per_byte


def mean_over_orders_s(hardware: int, software: int, size: int, costs) -> float:
    """The last hardware reader's end after the publication, over every order of deliveries."""
    places = itertools.combinations(range(1, hardware + software + 1), hardware)
    each_s = delivery_s(size, costs)
    ends = [shared_s([place * each_s for place in chosen], costs.memory.read_s(size)) for chosen in places]
    return fmean(ends) + costs.delegate_s + costs.endpoint_s


@BOTH
@pytest.mark.parametrize("size", MESSAGE_BYTES)
@pytest.mark.parametrize(("hardware", "software"), [(1, 1), (2, 1), (4, 1), (8, 1), (3, 3), (5, 0)])
def test_the_mean_place_stands_for_every_order_of_deliveries(hardware, software, size, costs):
    found = times(Side.SOFTWARE, Transport.SMT, size, costs, hardware=hardware, software=software)
    exact_s = (
        costs.publish_s + size * costs.publish_s_per_byte + mean_over_orders_s(hardware, software, size, costs)
    )
    assert found.hardware_s == pytest.approx(exact_s, rel=0.005)


@BOTH
def test_chunks_in_turn_give_the_same_time_as_the_formula(costs):
    size, hardware = 100_000, 8
    each_s, memory = delivery_s(size, costs), costs.memory
    releases = [(place + 1) * each_s for place in range(hardware)]
    ends = round_robin_s(releases, memory.chunks(size), memory.read_cycles / memory.clock_hz)
    found = times(Side.SOFTWARE, Transport.SMT, size, costs, hardware=hardware, software=0)
    fixed_s = costs.publish_s + size * costs.publish_s_per_byte + costs.delegate_s + costs.endpoint_s
    assert found.hardware_s == pytest.approx(fixed_s + max(ends), rel=1e-9)


def test_over_a_software_topic_each_hardware_reader_adds_one_reading_of_a_large_message():
    size = 10_000_000
    few, many = (times(Side.HARDWARE, Transport.SMT, size, hardware=n).hardware_s for n in (4, 8))
    assert many - few == pytest.approx(4 * STORED.memory.read_s(size), rel=0.01)


@pytest.mark.parametrize("publisher", Side)
def test_through_a_gateway_the_number_of_hardware_readers_does_not_matter(publisher):
    assert times(publisher, Transport.GATEWAY, hardware=2) == times(publisher, Transport.GATEWAY, hardware=8)


def test_a_stream_without_a_gateway_is_the_fastest_way_between_hardware_nodes():
    stream, gateway, memory = (
        times(Side.HARDWARE, kind, software=int(kind is not Transport.HMT)).hardware_s
        for kind in (Transport.HMT, Transport.GATEWAY, Transport.SMT)
    )
    assert stream < gateway < memory


def test_a_gateway_costs_a_hardware_publishers_software_reader_the_cores_turn_and_the_cancel():
    without = replace(STORED, cancel_s=0.0)
    full, free = (times(Side.HARDWARE, Transport.GATEWAY, costs=c).software_s for c in (STORED, without))
    assert full - free == pytest.approx(STORED.cancel_s)


def test_who_does_not_subscribe_has_no_time():
    assert times(Side.SOFTWARE, Transport.SMT, hardware=0).hardware_s is None
    assert times(Side.SOFTWARE, Transport.SMT, software=0).software_s is None


@given(
    publisher=st.sampled_from(Side),
    transport=st.sampled_from([Transport.SMT, Transport.GATEWAY]),
    size=st.integers(1, 10_000_000),
    hardware=st.integers(1, 16),
    software=st.integers(1, 4),
)
def test_a_larger_message_and_more_readers_never_arrive_earlier(publisher, transport, size, hardware, software):
    here = times(publisher, transport, size, hardware=hardware, software=software)
    for later in (
        times(publisher, transport, size + 1000, hardware=hardware, software=software),
        times(publisher, transport, size, hardware=hardware + 1, software=software),
        times(publisher, transport, size, hardware=hardware, software=software + 1),
    ):
        assert later.hardware_s >= here.hardware_s - 1e-12
        assert later.software_s >= here.software_s - 1e-12


@pytest.mark.parametrize(
    ("publisher", "software"), [(Side.SOFTWARE, 0), (Side.HARDWARE, 1)], ids=["publisher", "subscriber"]
)
def test_software_does_not_reach_a_hardware_topic(publisher, software):
    with pytest.raises(MemoryInterfaceError, match="only hardware nodes"):
        times(publisher, Transport.HMT, software=software)


def test_an_empty_message_is_refused():
    with pytest.raises(MemoryInterfaceError, match="needs a message"):
        times(Side.SOFTWARE, Transport.SMT, 0)


def test_negative_costs_are_refused_by_name():
    with pytest.raises(MemoryInterfaceError, match="cancel_s"):
        replace(STORED, cancel_s=-1.0)
