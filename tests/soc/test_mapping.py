"""Communication mapping: paper C's three cases, its example, what holds for every graph, a rule of sizes."""

from dataclasses import replace

import pytest
from graph_strategies import GRAPHS, HW, SW, graphs
from hypothesis import given, settings

from sfglab import soc
from sfglab.errors import InvalidValueError
from sfglab.soc.mapping import (
    carriages_per_message,
    hardware_subgraphs,
    more_than_one_hardware_subscriber,
)
from sfglab.soc.memory import Judge, Setup, Side, Transport, break_even_bytes, transfer_times

KINDS = tuple(soc.TopicMapping)
FIGURE_8 = soc.load_graph(GRAPHS / "figure_8.yaml")
EXAMPLE = soc.map_communication(FIGURE_8)
SOME = settings(max_examples=60, deadline=None)


def one_topic(publishers, subscribers):
    """A graph with one topic; nodes in hardware are named h..., nodes in software s..."""
    members = dict.fromkeys((*publishers, *subscribers))
    nodes = tuple(soc.Node(name=name, placement=HW if name[0] == "h" else SW) for name in members)
    return soc.Graph(
        nodes=nodes, topics=(soc.Topic(name="t", publishers=publishers, subscribers=subscribers),)
    )


def test_the_paper_s_example_has_the_paper_s_sets_and_ten_then_eight_then_three_edges():
    assert EXAMPLE.crossing == (10, 8, 3)
    found = [soc.crossing_edges(graph) for graph in EXAMPLE.stages]
    assert [(len(c.publications), len(c.subscriptions)) for c in found] == [(3, 7), (2, 6), (1, 2)]
    left = {str(edge) for edge in (*found[2].publications, *found[2].subscriptions)}
    assert left == {"A -> 8", "C -> 6", "9 -> E"}
    assert [EXAMPLE.software.mapped_to(kind) for kind in KINDS] == [tuple("ABCDE"), (), ()]
    assert [EXAMPLE.hardware.mapped_to(kind) for kind in KINDS] == [tuple("ACDE"), ("B",), ()]
    assert [EXAMPLE.gateways.mapped_to(kind) for kind in KINDS] == [("D",), ("B",), tuple("ACE")]


def test_the_dashed_parts_grow_and_another_rule_may_decide_between_software_and_gateway():
    assert len(hardware_subgraphs(EXAMPLE.software)) == 8
    assert (frozenset("24"), frozenset("B")) in hardware_subgraphs(EXAMPLE.hardware)
    parts = hardware_subgraphs(EXAMPLE.gateways)
    assert set(parts) == {
        (frozenset("123457"), frozenset("ABC")),
        (frozenset({"10", "11"}), frozenset("E")),
    }
    graph = one_topic(("h1",), ("s1", "h2"))
    asked = []
    done = soc.map_communication(
        graph, gateway=lambda g, t: asked.append((g.in_hardware, t.name)) or True
    )
    assert asked == [({"h1", "h2"}, "t")]
    assert done.gateways.mapped_to(soc.TopicMapping.GATEWAY) == ("t",)


@SOME
@given(graphs())
def test_each_topic_goes_where_section_5_says_whatever_it_was_mapped_to_before(graph):
    done = soc.map_communication(graph)
    assert soc.map_communication(done.gateways) == done
    for topic in done.gateways.topics:
        there = [graph.node(name).in_hardware for name in topic.members]
        subscribers = sum(graph.node(name).in_hardware for name in topic.subscribers)
        joins = soc.TopicMapping.GATEWAY if subscribers > 1 else soc.TopicMapping.SOFTWARE
        wanted = (
            soc.TopicMapping.HARDWARE
            if all(there)
            else joins
            if any(there)
            else soc.TopicMapping.SOFTWARE
        )
        assert topic.mapping is wanted
    assert [(n.name, n.placement) for n in done.gateways.nodes] == [
        (n.name, n.placement) for n in graph.nodes
    ]


@SOME
@given(graphs())
def test_topics_in_hardware_only_take_crossing_edges_away_and_gateways_have_those_of_software(
    graph,
):
    done = soc.map_communication(graph)
    first, before, after = (soc.crossing_edges(stage) for stage in done.stages)
    gone = {edge for edge in graph.edges() if edge in first and edge not in before}
    assert all(edge in first for edge in (*before.publications, *before.subscriptions))
    assert {edge.topic for edge in gone} <= set(done.hardware.mapped_to(soc.TopicMapping.HARDWARE))
    at = set(done.gateways.mapped_to(soc.TopicMapping.GATEWAY))
    for edge in graph.edges():
        assert (edge in after) is ((edge in before) is not (edge.topic in at))
        if edge.topic in at:
            assert (edge in after) is not graph.node(edge.node).in_hardware
    assert all(edge.kind is soc.EdgeKind.PUBLISH for edge in after.publications)
    assert all(edge.kind is soc.EdgeKind.SUBSCRIBE for edge in after.subscriptions)
    assert len(after) == sum(edge in after for edge in graph.edges())


@SOME
@given(graphs())
def test_no_stage_carries_a_message_more_often_and_a_gateway_carries_it_less_often(graph):
    done = soc.map_communication(graph)
    for topic in graph.topics:
        counts = [carriages_per_message(stage, stage.topic(topic.name)) for stage in done.stages]
        assert counts[0] >= counts[1] >= counts[2]
        if done.gateways.topic(topic.name).mapping is soc.TopicMapping.GATEWAY:
            assert counts[1] >= 2
            assert counts[2] == 1


@SOME
@given(graphs())
def test_parts_in_hardware_share_nothing_and_hold_every_hardware_node(graph):
    parts = hardware_subgraphs(soc.map_communication(graph).gateways)
    assert sorted(node for nodes, _ in parts for node in nodes) == sorted(graph.in_hardware)
    topics = [topic for _, inner in parts for topic in inner]
    assert len(topics) == len(set(topics))


def test_more_edges_may_cross_a_gateway_that_carries_less_and_carriages_are_a_mean():
    graph = one_topic(("h1",), ("h2", "h3", "s1", "s2", "s3", "s4"))
    done = soc.map_communication(graph)
    assert done.crossing == (3, 3, 4)
    assert [carriages_per_message(stage, stage.topics[0]) for stage in done.stages] == [3, 3, 1]
    graph = one_topic(("h1", "s1"), ("h2", "h3", "h4"))
    assert carriages_per_message(graph, graph.topics[0]) == 3.5
    assert more_than_one_hardware_subscriber(graph, graph.topics[0])


# The rule that knows sizes


def sized(size_bytes):
    return replace(
        FIGURE_8, topics=tuple(replace(t, size_bytes=size_bytes) for t in FIGURE_8.topics)
    )


def test_small_messages_get_no_gateway_by_the_rule_which_changes_where_the_model_breaks_even():
    large, small = sized(10_000_000), sized(100)
    assert soc.map_communication(large, gateway=soc.faster_by_gateway()) == soc.map_communication(
        large
    )
    assert soc.map_communication(small).gateways.mapped_to(soc.TopicMapping.GATEWAY) == (
        "A",
        "C",
        "E",
    )
    by_size = soc.map_communication(small, gateway=soc.faster_by_gateway()).gateways
    assert by_size.mapped_to(soc.TopicMapping.GATEWAY) == ()
    assert by_size.mapped_to(soc.TopicMapping.HARDWARE) == ("B",)
    setup = Setup(
        publisher=Side.SOFTWARE, transport=Transport.SMT, message_bytes=1, hardware=2, software=0
    )
    size_bytes = break_even_bytes(setup, Judge.LAST)
    assert size_bytes is not None
    rule = soc.faster_by_gateway()
    for graph, expected in ((sized(size_bytes), True), (sized(size_bytes - 256), False)):
        assert rule(graph, graph.topic("E")) is expected


def test_the_time_of_a_topic_is_the_model_s_for_its_nodes_and_one_of_unknown_size_is_refused():
    mapped = EXAMPLE.gateways
    sides = {"publisher": Side.HARDWARE, "hardware": 2, "software": 1}
    times = transfer_times(Setup(transport=Transport.GATEWAY, message_bytes=1_000_000, **sides))
    assert soc.transfer_s(mapped, mapped.topic("A"), judge=Judge.HARDWARE) == times.hardware_s
    assert soc.transfer_s(mapped, mapped.topic("A"), judge=Judge.SOFTWARE) == times.software_s
    graph = sized(None)
    with pytest.raises(InvalidValueError, match=r"topics\.A\.size_bytes: nothing is given"):
        soc.map_communication(graph, gateway=soc.faster_by_gateway())


@SOME
@given(graphs())
def test_with_the_rule_no_topic_is_slower_than_with_all_in_software(graph):
    known = replace(
        graph, topics=tuple(replace(t, size_bytes=t.size_bytes or 1) for t in graph.topics)
    )
    done = soc.map_communication(known, gateway=soc.faster_by_gateway())
    for topic in done.gateways.topics:
        if topic.mapping is not soc.TopicMapping.HARDWARE:
            before = soc.transfer_s(done.software, done.software.topic(topic.name))
            assert soc.transfer_s(done.gateways, topic) <= before
