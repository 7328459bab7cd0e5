"""A mapped graph as ReconROS's `build.cfg`: read back with the rules of the reader that ReconROS has."""

import configparser
import re
from dataclasses import replace

import pytest
from graph_strategies import FIGURE_8, HW, SW, chain, for_every_graph
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.soc import Graph, Node, Topic, build_cfg, map_communication

IMAGE = "sensor_msgs/msg/Image"


def read(graph, **options):
    """ReconROS reads with RawConfigParser, keys as they stand, and splits arguments at commas and blanks."""
    parser = configparser.RawConfigParser()
    parser.optionxform = str
    parser.read_string(build_cfg(graph, **options))
    return parser


def sections(parser, kind):
    titles = [title for title in parser.sections() if title.startswith(kind)]
    return {title.split("@")[1]: dict(parser[title]) for title in titles}


EXAMPLE = read(FIGURE_8.gateways, name="Fig. 8")


def test_nodes_and_gateways_have_slots_of_their_own_on_the_paper_s_board():
    gateways = sections(EXAMPLE, "ROSGateway")
    threads, slots = sections(EXAMPLE, "ReconosThread"), sections(EXAMPLE, "HwSlot")
    joined = {"HWTopic": '"A"', "SWTopic": '"A"', "MsgType": "sensor_msgs/Image"}
    assert gateways["gateway_A"] == {"Slot": "Gateways(0)", **joined}
    assert [gateway["Slot"][-2] for gateway in gateways.values()] == ["0", "1", "2"]
    assert set(threads) == {f"n{name}" for name in FIGURE_8.gateways.hardware_nodes}
    assert len({slot["Id"] for slot in slots.values()}) == len(slots) == 9
    for thread in threads.values():
        assert thread["Slot"].replace("(*)", "(0:0)") in slots
        assert thread["ResourceGroup"] in sections(EXAMPLE, "ResourceGroup")
    assert EXAMPLE["General"]["Name"] == "Fig_8"
    assert EXAMPLE["General"]["TargetPart"] == "xczu7ev-ffvc1156-2-e"


def test_a_topic_in_hardware_or_at_a_gateway_is_a_stream_and_one_in_software_a_message():
    assert sections(EXAMPLE, "ResourceGroup")["R_n2"] == {
        "node": 'rosnode, "2"',
        "sub_A": 'rossub, node, sensor_msgs/Image, "A", hw',
        "pub_B": 'rospub, node, sensor_msgs/Image, "B", hw',
    }
    assert sections(read(FIGURE_8.all_software), "ResourceGroup")["R_n2"] == {
        "node": 'rosnode, "2"',
        "sub_A_msg": "rosmsg, sensor_msgs, msg, Image",
        "sub_A": 'rossub, node, sub_A_msg, "A", 10000',
        "pub_B_msg": "rosmsg, sensor_msgs, msg, Image",
        "pub_B": 'rospub, node, pub_B_msg, "B"',
    }


def in_hardware(*names, topics=()):
    return Graph(nodes=tuple(Node(name=name, placement=HW) for name in names), topics=topics)


def test_names_that_become_one_are_told_apart():
    threads = sections(read(in_hardware("a/b", "A_b", "7")), "ReconosThread")
    assert set(threads) == {"a_b", "A_b_2", "n7"}


@pytest.mark.parametrize(
    ("graph", "said"),
    [
        (chain(HW, SW), r"topics\.ab\.type: nothing is given, needed: a ROS message"),
        (in_hardware("my node"), "nodes: given 'my node', allowed: names without"),
        (
            in_hardware("n", topics=(Topic(name="a, b", publishers=("n",), type=IMAGE),)),
            "topics: given 'a, b'",
        ),
    ],
)
def test_blanks_and_a_topic_without_message_type_are_refused(graph, said):
    with pytest.raises(InvalidValueError, match=said):
        build_cfg(graph)


@for_every_graph(names=st.from_regex(r"/?[a-z][a-z0-9_]{0,7}", fullmatch=True))
def test_every_graph_with_plain_names_is_read_as_it_was_written(graph):
    typed = replace(graph, topics=tuple(replace(topic, type=IMAGE) for topic in graph.topics))
    mapped = map_communication(typed).gateways
    parser = read(mapped)
    assert len(sections(parser, "ReconosThread")) == len(mapped.hardware_nodes)
    groups = sections(parser, "ResourceGroup").values()
    resources = [re.split(r"[, ]+", value) for group in groups for value in group.values()]
    edges = [edge for edge in mapped.edges() if edge.node in mapped.hardware_nodes]
    assert sum(args[0] in {"rospub", "rossub"} for args in resources) == len(edges)
