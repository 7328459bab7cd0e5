"""The chain's transfers: what the memory model gives for one frame, and what the order decides."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfglab.errors import InvalidValueError
from sfglab.soc import Placement, TopicMapping, load_graph
from sfglab.soc.driving import CHAIN, Chain
from sfglab.soc.memory import STORED, Setup, transfer_times

GRAPH = load_graph(Path(__file__).parents[2] / "data" / "graphs" / "driving.yaml")
DRIVING = Chain(GRAPH)
FRAME_BYTES = 640 * 480 * 3


def modelled_s(mapping):
    """The time of the transfer model until the last of three hardware readers has the message."""
    nodes = {"publisher": Placement.HARDWARE, "hardware_subscribers": 3}
    setup = Setup(mapping=mapping, message_bytes=FRAME_BYTES, **nodes)
    return transfer_times(setup, STORED)[Placement.HARDWARE]


def test_over_all_orders_the_last_reader_is_as_late_as_the_transfer_model_says():
    """The model has the mean in closed form; the orders are enumerated here."""
    lasts_s = [max(DRIVING.read_s(order).values()) for order in DRIVING.orders]
    assert len(lasts_s) == 24
    assert np.mean(lasts_s) == pytest.approx(modelled_s(TopicMapping.SOFTWARE), rel=1e-6)


def test_a_gateway_is_faster_than_the_first_place_and_that_than_the_last():
    times = DRIVING.software_s
    first, last = ([s for order, s in times.items() if order[at] == CHAIN[1]] for at in (0, -1))
    assert modelled_s(TopicMapping.GATEWAY) == DRIVING.gateway_s < min(times.values())
    assert max(first) < min(last)


def test_a_graph_without_the_chain_is_refused():
    topics = tuple(topic for topic in GRAPH.topics if topic.name != "/lane_mask")
    with pytest.raises(InvalidValueError, match="chain: given 'lane_planner, polyfit'"):
        _ = Chain(replace(GRAPH, topics=topics)).fixed_s
