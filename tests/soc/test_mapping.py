"""Communication mapping: paper C's three cases, its example, what holds for every graph, a rule of sizes."""

from dataclasses import replace

import pytest
from graph_strategies import FIGURE_8, HW, SW, for_every_graph

from sfglab import soc
from sfglab.soc import EdgeKind, TopicMapping
from sfglab.soc.mapping import carriages_per_message
from sfglab.soc.memory import Setup, transfer_times


def sized(graph, size_bytes):
    """A graph with messages of one size."""
    topics = tuple(replace(topic, size_bytes=size_bytes) for topic in graph.topics)
    return replace(graph, topics=topics)


def test_the_paper_s_example_has_the_paper_s_sets_and_ten_then_eight_then_three_edges():
    assert FIGURE_8.crossing == (10, 8, 3)
    sets = [[graph.mapped_to(kind) for kind in TopicMapping] for graph in FIGURE_8.stages]
    assert sets[0] == [tuple("ABCDE"), (), ()]
    assert sets[1] == [tuple("ACDE"), ("B",), ()]
    assert sets[2] == [("D",), ("B",), tuple("ACE")]


@for_every_graph()
def test_each_topic_goes_where_section_5_says_whatever_it_was_mapped_to_before(graph):
    done = soc.map_communication(graph)
    assert soc.map_communication(done.gateways) == done
    assert done.gateways.nodes == graph.nodes
    for topic in done.gateways.topics:
        wanted = TopicMapping.SOFTWARE
        if graph.hardware_nodes.issuperset(topic.members):
            wanted = TopicMapping.HARDWARE
        elif len(graph.hardware_nodes & set(topic.subscribers)) > 1:
            wanted = TopicMapping.GATEWAY
        assert topic.mapping is wanted


@for_every_graph()
def test_edges_cross_as_section_5_counts_them_and_no_stage_carries_a_message_more_often(graph):
    done = soc.map_communication(graph)
    for stage in done.stages:
        crossing = soc.crossing_edges(stage)
        for edge in graph.edges():
            in_software = stage.topic(edge.topic).mapping is TopicMapping.SOFTWARE
            assert (edge in crossing) is (graph.node(edge.node).in_hardware is in_software)
        kinds = [edge.kind for edge in crossing]
        assert kinds == sorted(kinds, key=list(EdgeKind).index)
    for topic in done.gateways.topics:
        counts = [carriages_per_message(stage, stage.topic(topic.name)) for stage in done.stages]
        assert counts == sorted(counts, reverse=True)
        assert topic.mapping is not TopicMapping.GATEWAY or counts[1] >= 2 > counts[2] == 1


@pytest.mark.parametrize(
    ("publishers", "subscribers", "edges", "carriages"),
    [
        ("H", "IJabcd", (3, 3, 4), [3, 3, 1]),  # more edges cross a gateway that carries less
        ("Ha", "IJK", (4, 4, 1), [3.5, 3.5, 1]),  # a mean over publishers
    ],
)
def test_edges_and_carriages_are_counted_apart(publishers, subscribers, edges, carriages):
    sides = {name: HW if name.isupper() else SW for name in publishers + subscribers}
    nodes = [soc.Node(name=name, placement=side) for name, side in sides.items()]
    topic = soc.Topic(name="t", publishers=tuple(publishers), subscribers=tuple(subscribers))
    done = soc.map_communication(soc.Graph(nodes=tuple(nodes), topics=(topic,)))
    assert done.crossing == edges
    assert [carriages_per_message(stage, stage.topics[0]) for stage in done.stages] == carriages


@pytest.mark.parametrize(
    ("size_bytes", "gateways"), [(10_000, ""), (100_000, "AC"), (1_000_000, "ACE")]
)
def test_the_rule_of_sizes_gives_a_gateway_to_topics_that_the_model_carries_faster(
    size_bytes, gateways
):
    graph = sized(FIGURE_8.all_software, size_bytes)
    mapped = soc.map_communication(graph, gateway=soc.faster_by_gateway).gateways
    assert mapped.mapped_to(TopicMapping.GATEWAY) == tuple(gateways)
    assert mapped.mapped_to(TopicMapping.HARDWARE) == ("B",)


@pytest.mark.parametrize(("size_bytes", "counted"), [(1_000_000, 1_000_000), (0, 1)])
def test_the_time_of_a_topic_is_the_model_s_for_its_nodes(size_bytes, counted):
    mapped = sized(FIGURE_8.gateways, size_bytes)
    sides = {"publisher": HW, "hardware_subscribers": 2, "software_subscribers": 1}
    times = transfer_times(Setup(mapping=TopicMapping.GATEWAY, message_bytes=counted, **sides))
    topic = mapped.topic("A")
    assert soc.transfer_s(mapped, topic, side=HW) == times[HW]
    assert soc.transfer_s(mapped, topic, side=SW) == times[SW]
    assert soc.transfer_s(mapped, replace(topic, subscribers=()), side=SW) == 0.0
