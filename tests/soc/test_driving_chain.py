"""The chain's transfers: what the memory model says for one frame, and what is left to chance."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfglab.errors import SfglabError
from sfglab.soc import Placement, load_graph
from sfglab.soc.driving import CHAIN, Chain
from sfglab.soc.memory import STORED, Setup, Side, Transport, transfer_times

GRAPH = load_graph(Path(__file__).parents[2] / "data" / "graphs" / "driving.yaml")
DRIVING = Chain(GRAPH)
FRAME_BYTES = 640 * 480 * 3


def test_over_all_orders_the_last_reader_is_as_late_as_the_transfer_model_says():
    """The model has the mean in closed form; the orders are enumerated here."""
    setup = Setup(
        publisher=Side.HARDWARE, transport=Transport.SMT, message_bytes=FRAME_BYTES, hardware=3
    )
    lasts_s = [max(DRIVING.read_s(order).values()) for order in DRIVING.orders]
    assert len(lasts_s) == 24
    assert np.mean(lasts_s) == pytest.approx(transfer_times(setup, STORED).hardware_s, rel=1e-6)


def test_the_blur_is_early_when_served_first_and_late_when_served_last():
    """Earliest of all where the odometry is next: its delivery keeps the detectors from the interface."""
    times = DRIVING.smt_s
    assert min(times, key=times.__getitem__)[:2] == ("gaussian_blur", "visual_odometry")
    assert max(times, key=times.__getitem__)[-1] == "gaussian_blur"
    first, last = (
        [s for order, s in times.items() if order[place] == "gaussian_blur"] for place in (0, -1)
    )
    assert max(first) < min(last)


def test_software_alone_before_the_blur_costs_it_one_delivery_and_no_turn():
    """The odometry takes no turn at the memory interface."""
    rest = ("red_light_detection", "green_light_detection")
    first = DRIVING.read_s(("gaussian_blur", *rest, "visual_odometry"))["gaussian_blur"]
    second = DRIVING.read_s(("visual_odometry", "gaussian_blur", *rest))["gaussian_blur"]
    delivery_s = STORED.deliver_s + STORED.deliver_s_per_byte * FRAME_BYTES
    assert second - first == pytest.approx(delivery_s, rel=1e-6)


def test_a_gateway_is_as_fast_as_the_model_says_and_other_topics_are_streams_in_hardware():
    setup = Setup(
        publisher=Side.HARDWARE, transport=Transport.GATEWAY, message_bytes=FRAME_BYTES, hardware=3
    )
    assert DRIVING.gateway_s == transfer_times(setup, STORED).hardware_s
    assert DRIVING.gateway_s < min(DRIVING.smt_s.values())
    assert set(DRIVING.fixed_s) == {"/blurred", "/lane_mask", "/lane"}
    stream_s = 2 * STORED.endpoint_s + STORED.memory.stream_s(FRAME_BYTES)
    assert DRIVING.fixed_s["/blurred"] == pytest.approx(stream_s)
    assert DRIVING.fixed_s["/lane"] > STORED.endpoint_s + STORED.publish_s + STORED.delegate_s


def test_a_drawn_order_comes_from_the_generator_and_every_order_comes():
    first, again = (DRIVING.draw(1000, np.random.default_rng(3)) for _ in range(2))
    assert (first == again).all()
    assert set(first.tolist()) == set(range(24))


def test_a_graph_without_the_chain_or_with_a_member_outside_hardware_is_refused():
    for name in CHAIN[:2]:
        with pytest.raises(SfglabError, match="must be in hardware"):
            Chain(GRAPH.with_placements({name: Placement.SOFTWARE}))
    topics = tuple(topic for topic in GRAPH.topics if topic.name != "/lane_mask")
    with pytest.raises(SfglabError, match="from lane_planner to polyfit"):
        Chain(replace(GRAPH, topics=topics))
