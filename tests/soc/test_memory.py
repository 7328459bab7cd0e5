"""The memory model: cycles, turns at the interface, transfer times and break-even sizes."""

import itertools
from dataclasses import replace
from statistics import fmean

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.soc import Placement
from sfglab.soc.memory import (
    LARGEST_BYTES,
    STORED,
    MemoryInterface,
    Receiver,
    Setup,
    Times,
    Transport,
    break_even_bytes,
    faster_transport,
    received_s,
    round_robin_s,
    shared_s,
    transfer_times,
)
from sfglab.soc.paper_values import MESSAGE_BYTES

MEMIF = MemoryInterface()
CHUNK_BYTES = MEMIF.chunk_bytes
SIDES = st.sampled_from(Placement)


def setup(publisher=Placement.HARDWARE, transport=Transport.SMT, size=1_000_000, **nodes):
    nodes = {"hardware": 4, **nodes}
    return Setup(publisher=publisher, transport=transport, message_bytes=size, **nodes)


def times(*args, **nodes):
    return transfer_times(setup(*args, **nodes))


def test_a_chunk_takes_data_control_and_latency_cycles_and_a_stream_one_word_per_cycle():
    assert (MEMIF.data_cycles, MEMIF.read_cycles, MEMIF.write_cycles) == (32, 66, 45)
    assert (MEMIF.memory_to_stream_cycles, MEMIF.stream_to_memory_cycles) == (98, 77)
    assert MEMIF.read_s(1) == MEMIF.read_s(256) == pytest.approx(660e-9)
    assert [MEMIF.chunks(size) for size in (1, 256, 257)] == [1, 1, 2]
    assert [MEMIF.stream_s(size) for size in (1, 10_000_000)] == pytest.approx([10e-9, 12.5e-3])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 400), min_size=1, max_size=8), st.integers(1, 40))
def test_the_last_of_several_nodes_ends_with_the_busy_period_whatever_the_turns(releases, chunks):
    ends = round_robin_s(releases, chunks, 1.0)
    assert max(ends) == pytest.approx(shared_s(releases, chunks))
    assert all(end >= release + chunks for end, release in zip(ends, releases, strict=True))


@pytest.mark.parametrize("size", MESSAGE_BYTES)
@pytest.mark.parametrize(("hardware", "software"), [(1, 1), (4, 1), (8, 1), (3, 3), (5, 0)])
def test_mean_places_stand_for_all_orders_of_deliveries(hardware, software, size):
    found = times(Placement.SOFTWARE, Transport.SMT, size, hardware=hardware, software=software)
    orders = itertools.combinations(range(1, hardware + software + 1), hardware)
    each_s, read_s = STORED.delivery_s(size), STORED.memory.read_s(size)
    exact_s = fmean(shared_s([place * each_s for place in order], read_s) for order in orders)
    fixed_s = STORED.published_s(size) + STORED.delegate_s + STORED.endpoint_s
    # Without a software subscriber there is only one order of places.
    assert found.hardware_s == pytest.approx(fixed_s + exact_s, rel=0.005 if software else 1e-9)


def test_over_a_software_mapped_topic_each_hardware_subscriber_adds_a_reading():
    few, many = (times(size=10_000_000, hardware=n).hardware_s for n in (4, 8))
    assert many - few == pytest.approx(4 * STORED.memory.read_s(10_000_000), rel=0.01)
    stream = times(Placement.HARDWARE, Transport.HMT, software=0).hardware_s
    assert stream < times(Placement.HARDWARE, Transport.GATEWAY).hardware_s < times().hardware_s


@pytest.mark.parametrize("publisher", Placement)
def test_through_a_gateway_the_number_of_hardware_subscribers_has_no_effect(publisher):
    few, many = (times(publisher, Transport.GATEWAY, hardware=n) for n in (2, 8))
    assert few == many


def test_a_gateway_costs_a_software_subscriber_the_cancellation_and_no_subscriber_has_no_time():
    through = setup(transport=Transport.GATEWAY)
    free = transfer_times(through, replace(STORED, cancel_s=0.0)).software_s
    assert transfer_times(through).software_s - free == pytest.approx(STORED.cancel_s)
    nobody = setup(hardware=0, software=0)
    assert transfer_times(nobody) == Times(hardware_s=None, software_s=None)
    assert received_s(transfer_times(nobody), Receiver.LAST) == 0.0
    assert faster_transport(nobody) is Transport.SMT


@given(
    publisher=SIDES,
    transport=st.sampled_from([Transport.SMT, Transport.GATEWAY]),
    size=st.integers(1, 10_000_000),
    hardware=st.integers(1, 16),
    software=st.integers(1, 4),
)
def test_larger_messages_and_more_subscribers_never_arrive_earlier(
    publisher, transport, size, hardware, software
):
    here = times(publisher, transport, size, hardware=hardware, software=software)
    for bytes_, hw, sw in ((1000, 0, 0), (0, 1, 0), (0, 0, 1)):
        nodes = {"hardware": hardware + hw, "software": software + sw}
        later = times(publisher, transport, size + bytes_, **nodes)
        assert later.hardware_s >= here.hardware_s - 1e-12
        assert later.software_s >= here.software_s - 1e-12


def test_break_even_sizes_fall_with_the_number_of_subscribers_and_depend_on_the_judge():
    sizes = [
        break_even_bytes(setup(Placement.SOFTWARE, hardware=n), Receiver.HARDWARE)
        for n in (1, 2, 4, 8)
    ]
    assert sizes == [None, 301_056, 60_928, 11_264]
    by_judge = {judge: break_even_bytes(setup(), judge) for judge in Receiver}
    assert by_judge == {
        Receiver.HARDWARE: CHUNK_BYTES,
        Receiver.SOFTWARE: None,
        Receiver.LAST: 27_392,
    }


@given(
    publisher=SIDES,
    hardware=st.integers(1, 8),
    software=st.integers(0, 3),
    judge=st.sampled_from(Receiver),
    size=st.integers(1, LARGEST_BYTES),
)
def test_below_the_break_even_the_topic_is_faster_and_above_it_the_gateway(
    publisher, hardware, software, judge, size
):
    at = setup(publisher, size=size, hardware=hardware, software=software)
    limit = break_even_bytes(at, judge)
    if limit is None or size <= limit - CHUNK_BYTES:
        assert faster_transport(at, judge) is Transport.SMT
    elif size >= limit:
        assert faster_transport(at, judge) is Transport.GATEWAY


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MemoryInterface(width_bytes=0), "width_bytes: given 0, allowed: above zero"),
        (lambda: replace(STORED, cancel_s=-1.0), "cancel_s: given -1.0, allowed: from 0"),
        (lambda: setup(size=0), "allowed: a message and no negative number"),
        (lambda: setup(Placement.HARDWARE, Transport.HMT), "only hardware nodes"),
    ],
)
def test_impossible_values_are_refused_by_name(make, message):
    with pytest.raises(InvalidValueError, match=message):
        make()
