"""Predicted times of a graph's topics, and the gateway rule that knows sizes."""

from __future__ import annotations

from dataclasses import replace

import pytest
from graph_strategies import GRAPHS, graphs
from hypothesis import given, settings

from sfglab.errors import InvalidValueError
from sfglab.soc import TopicMapping, faster_by_gateway, load_graph, map_communication, transfer_s
from sfglab.soc.memory import Judge, Setup, Side, Transport, break_even_bytes, transfer_times

EXAMPLE = load_graph(GRAPHS / "figure_8.yaml")


def sized(size_bytes):
    return replace(EXAMPLE, topics=tuple(replace(t, size_bytes=size_bytes) for t in EXAMPLE.topics))


def test_large_messages_are_mapped_as_the_paper_maps_them_and_small_ones_get_no_gateway():
    large, small = sized(10_000_000), sized(100)
    assert map_communication(large, gateway=faster_by_gateway()) == map_communication(large)
    assert map_communication(small).gateways.mapped_to(TopicMapping.GATEWAY) == ("A", "C", "E")
    by_size = map_communication(small, gateway=faster_by_gateway()).gateways
    assert by_size.mapped_to(TopicMapping.GATEWAY) == ()
    assert by_size.mapped_to(TopicMapping.HARDWARE) == ("B",)


def test_the_rule_changes_its_mind_where_the_model_breaks_even():
    setup = Setup(publisher=Side.SOFTWARE, transport=Transport.SMT, message_bytes=1, hardware=2, software=0)
    size_bytes = break_even_bytes(setup, Judge.LAST)
    assert size_bytes is not None
    rule = faster_by_gateway()
    for graph, expected in ((sized(size_bytes), True), (sized(size_bytes - 256), False)):
        assert rule(graph, graph.topic("E")) is expected


def test_the_time_of_a_topic_is_the_model_s_for_its_nodes():
    mapped = map_communication(EXAMPLE).gateways
    setup = Setup(
        publisher=Side.HARDWARE, transport=Transport.GATEWAY, message_bytes=1_000_000, hardware=2, software=1
    )
    times = transfer_times(setup)
    assert transfer_s(mapped, mapped.topic("A"), judge=Judge.HARDWARE) == times.hardware_s
    assert transfer_s(mapped, mapped.topic("A"), judge=Judge.SOFTWARE) == times.software_s


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_with_the_rule_no_topic_is_slower_than_with_all_in_software(graph):
    known = replace(graph, topics=tuple(replace(t, size_bytes=t.size_bytes or 1) for t in graph.topics))
    done = map_communication(known, gateway=faster_by_gateway())
    for topic in done.gateways.topics:
        if topic.mapping is not TopicMapping.HARDWARE:
            before = transfer_s(done.software, done.software.topic(topic.name))
            assert transfer_s(done.gateways, topic) <= before


def test_a_topic_of_unknown_size_is_refused_by_name():
    graph = sized(None)
    with pytest.raises(InvalidValueError, match=r"topics\.A\.size_bytes: nothing is given"):
        map_communication(graph, gateway=faster_by_gateway())
