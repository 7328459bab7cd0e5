"""Communication mapping: paper C's three cases, its example, what holds for every graph, a rule of sizes."""

from dataclasses import replace

import pytest
from graph_strategies import FIGURE_8, HW, SW, graphs
from hypothesis import given, settings

from sfglab import soc
from sfglab.errors import InvalidValueError
from sfglab.soc.mapping import carriages_per_message, hardware_parts
from sfglab.soc.memory import Receiver, Setup, Transport, break_even_bytes, transfer_times

KINDS = tuple(soc.TopicMapping)
SOME = settings(max_examples=60, deadline=None)


def one_topic(publishers, subscribers):
    """A graph with one topic; nodes in hardware are named h..., nodes in software s..."""
    members = dict.fromkeys(publishers + subscribers)
    nodes = tuple(soc.Node(name=name, placement=HW if name[0] == "h" else SW) for name in members)
    topic = soc.Topic(name="t", publishers=publishers, subscribers=subscribers)
    return soc.Graph(nodes=nodes, topics=(topic,))


def sized(size_bytes):
    """The paper's example with messages of one size."""
    graph = FIGURE_8.software
    return replace(graph, topics=tuple(replace(t, size_bytes=size_bytes) for t in graph.topics))


def test_the_paper_s_example_has_the_paper_s_sets_and_ten_then_eight_then_three_edges():
    found = [soc.crossing_edges(graph) for graph in FIGURE_8.stages]
    assert FIGURE_8.crossing == (10, 8, 3)
    assert [(len(c.publications), len(c.subscriptions)) for c in found] == [(3, 7), (2, 6), (1, 2)]
    left = {str(edge) for edge in found[2].publications + found[2].subscriptions}
    assert left == {"A -> 8", "C -> 6", "9 -> E"}
    assert [FIGURE_8.software.mapped_to(kind) for kind in KINDS] == [tuple("ABCDE"), (), ()]
    assert [FIGURE_8.hardware.mapped_to(kind) for kind in KINDS] == [tuple("ACDE"), ("B",), ()]
    assert [FIGURE_8.gateways.mapped_to(kind) for kind in KINDS] == [("D",), ("B",), tuple("ACE")]


def test_the_dashed_parts_of_the_paper_s_example_grow():
    assert len(hardware_parts(FIGURE_8.software)) == 8
    parts = [{name for _, name in part} for part in hardware_parts(FIGURE_8.hardware)]
    assert set("24B") in parts
    parts = [{name for _, name in part} for part in hardware_parts(FIGURE_8.gateways)]
    assert sorted(map(sorted, parts)) == [sorted("123457ABC"), ["10", "11", "E"]]


@SOME
@given(graphs())
def test_each_topic_goes_where_section_5_says_whatever_it_was_mapped_to_before(graph):
    done = soc.map_communication(graph)
    assert soc.map_communication(done.gateways) == done
    assert done.gateways.nodes == graph.nodes
    for topic in done.gateways.topics:
        there = [graph.node(name).in_hardware for name in topic.members]
        wanted = soc.TopicMapping.SOFTWARE
        if all(there):
            wanted = soc.TopicMapping.HARDWARE
        elif sum(graph.node(name).in_hardware for name in topic.subscribers) > 1:
            wanted = soc.TopicMapping.GATEWAY
        assert topic.mapping is wanted


@SOME
@given(graphs())
def test_edges_cross_as_section_5_counts_them_and_no_stage_carries_a_message_more_often(graph):
    done = soc.map_communication(graph)
    for stage in done.stages:
        crossing = soc.crossing_edges(stage)
        for edge in graph.edges():
            there = graph.node(edge.node).in_hardware
            in_software = stage.topic(edge.topic).mapping is soc.TopicMapping.SOFTWARE
            assert (edge in crossing) is (there is in_software)
        assert {edge.kind for edge in crossing.publications} <= {soc.EdgeKind.PUBLISH}
        assert {edge.kind for edge in crossing.subscriptions} <= {soc.EdgeKind.SUBSCRIBE}
    for topic in done.gateways.topics:
        counts = [carriages_per_message(stage, stage.topic(topic.name)) for stage in done.stages]
        assert counts == sorted(counts, reverse=True)
        assert topic.mapping is not soc.TopicMapping.GATEWAY or counts[1] >= 2 > counts[2] == 1


@SOME
@given(graphs())
def test_parts_in_hardware_share_nothing_and_hold_every_hardware_node(graph):
    mapped = soc.map_communication(graph).gateways
    held = sorted(vertex for part in hardware_parts(mapped) for vertex in part)
    wanted = [("node", name) for name in mapped.in_hardware]
    for kind in KINDS[1:]:
        wanted += [("topic", name) for name in mapped.mapped_to(kind)]
    assert held == sorted(wanted)


def test_more_edges_may_cross_a_gateway_that_carries_less_and_carriages_are_a_mean():
    done = soc.map_communication(one_topic(("h1",), ("h2", "h3", "s1", "s2", "s3", "s4")))
    assert done.crossing == (3, 3, 4)
    assert [carriages_per_message(stage, stage.topics[0]) for stage in done.stages] == [3, 3, 1]
    graph = one_topic(("h1", "s1"), ("h2", "h3", "h4"))
    assert carriages_per_message(graph, graph.topics[0]) == 3.5


def test_the_rule_of_sizes_changes_where_the_model_breaks_even():
    large = sized(10_000_000)
    rule = soc.faster_by_gateway
    assert soc.map_communication(large, gateway=rule) == soc.map_communication(large)
    small = soc.map_communication(sized(100), gateway=rule).gateways
    assert small.mapped_to(soc.TopicMapping.GATEWAY) == ()
    assert small.mapped_to(soc.TopicMapping.HARDWARE) == ("B",)
    sides = {"publisher": SW, "hardware": 2, "software": 0}
    setup = Setup(transport=Transport.SMT, message_bytes=1, **sides)
    size_bytes = break_even_bytes(setup, Receiver.LAST)
    assert rule(sized(size_bytes), sized(size_bytes).topic("E"))
    assert not rule(sized(size_bytes - 256), sized(size_bytes - 256).topic("E"))


def test_the_time_of_a_topic_is_the_model_s_for_its_nodes_and_one_of_unknown_size_is_refused():
    mapped = FIGURE_8.gateways
    sides = {"publisher": HW, "hardware": 2, "software": 1}
    times = transfer_times(Setup(transport=Transport.GATEWAY, message_bytes=1_000_000, **sides))
    assert soc.transfer_s(mapped, mapped.topic("A"), receiver=Receiver.HARDWARE) == times.hardware_s
    assert soc.transfer_s(mapped, mapped.topic("A"), receiver=Receiver.SOFTWARE) == times.software_s
    with pytest.raises(InvalidValueError, match=r"topics\.A\.size_bytes: nothing is given"):
        soc.map_communication(sized(None), gateway=soc.faster_by_gateway)


@SOME
@given(graphs())
def test_with_the_rule_of_sizes_no_topic_is_slower_than_with_all_in_software(graph):
    topics = tuple(replace(t, size_bytes=t.size_bytes or 1) for t in graph.topics)
    done = soc.map_communication(replace(graph, topics=topics), gateway=soc.faster_by_gateway)
    for topic in done.gateways.topics:
        if topic.mapping is not soc.TopicMapping.HARDWARE:
            before = soc.transfer_s(done.software, done.software.topic(topic.name))
            assert soc.transfer_s(done.gateways, topic) <= before
