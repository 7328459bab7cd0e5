"""A mapped graph as ReconROS's `build.cfg`: read back with the rules of the reader that ReconROS has."""

import configparser
import re
from dataclasses import replace

import pytest
from graph_strategies import FIGURE_8, HW, SW, chain, graphs
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.soc import Graph, Node, Topic, build_cfg, map_communication

IMAGE = "sensor_msgs/msg/Image"


def read(text):
    """ReconROS reads with RawConfigParser, keys as they stand, and splits arguments at commas and blanks."""
    parser = configparser.RawConfigParser()
    parser.optionxform = str
    parser.read_string(text)
    return parser


def sections(parser, kind):
    return {
        title.split("@")[1]: dict(parser[title])
        for title in parser.sections()
        if title.startswith(kind)
    }


EXAMPLE = read(build_cfg(FIGURE_8.gateways, name="Fig. 8"))


def test_each_gateway_has_a_slot_and_joins_stream_and_topic_on_the_paper_s_board():
    found = sections(EXAMPLE, "ROSGateway")
    joined = {"HWTopic": '"A"', "SWTopic": '"A"', "MsgType": "sensor_msgs/Image"}
    assert found["gateway_A"] == {"Slot": "Gateways(0)", **joined}
    slots = [gateway["Slot"] for gateway in found.values()]
    assert slots == ["Gateways(0)", "Gateways(1)", "Gateways(2)"]
    assert sections(EXAMPLE, "HwSlot")["Gateways(0:2)"] == {"Id": "8", "Clock": "System"}
    assert EXAMPLE["General"]["Name"] == "Fig_8"
    assert EXAMPLE["General"]["TargetPart"] == "xczu7ev-ffvc1156-2-e"
    assert EXAMPLE["Clock@System"]["ClockFreq"] == "100000000"


def test_each_hardware_node_has_a_thread_in_a_slot_of_its_own():
    threads, slots = sections(EXAMPLE, "ReconosThread"), sections(EXAMPLE, "HwSlot")
    assert set(threads) == {f"n{name}" for name in FIGURE_8.gateways.in_hardware}
    assert len({slot["Id"] for slot in slots.values()}) == len(slots) == 9
    for thread in threads.values():
        assert thread["Slot"].replace("(*)", "(0:0)") in slots
        assert thread["ResourceGroup"] in sections(EXAMPLE, "ResourceGroup")


def test_a_topic_in_hardware_or_at_a_gateway_is_a_stream_and_one_in_software_a_message():
    assert sections(EXAMPLE, "ResourceGroup")["R_n2"] == {
        "node": 'rosnode, "2"',
        "sub_A": 'rossub, node, sensor_msgs/Image, "A", hw',
        "pub_B": 'rospub, node, sensor_msgs/Image, "B", hw',
    }
    assert sections(read(build_cfg(FIGURE_8.software)), "ResourceGroup")["R_n2"] == {
        "node": 'rosnode, "2"',
        "sub_A_msg": "rosmsg, sensor_msgs, msg, Image",
        "sub_A": 'rossub, node, sub_A_msg, "A", 10000',
        "pub_B_msg": "rosmsg, sensor_msgs, msg, Image",
        "pub_B": 'rospub, node, pub_B_msg, "B"',
    }


def test_names_that_become_one_are_told_apart_and_blanks_or_no_message_type_refused():
    nodes = tuple(Node(name=name, placement=HW) for name in ("a/b", "A_b", "7"))
    threads = sections(read(build_cfg(Graph(nodes=nodes))), "ReconosThread")
    assert set(threads) == {"a_b", "A_b_2", "n7"}
    topic = Topic(name="a, b", publishers=("n",), type=IMAGE)
    refused = {
        r"topics\.ab\.type: nothing is given, allowed: a ROS message": chain(HW, SW),
        "nodes: given 'my node', allowed: names without": Graph(
            nodes=(Node(name="my node", placement=HW),)
        ),
        "topics: given 'a, b'": Graph(nodes=(Node(name="n", placement=HW),), topics=(topic,)),
    }
    for said, graph in refused.items():
        with pytest.raises(InvalidValueError, match=said):
            build_cfg(graph)
    assert "ROSGateway" not in build_cfg(chain(SW, SW))


@settings(max_examples=60, deadline=None)
@given(graphs(names=st.from_regex(r"/?[a-z][a-z0-9_]{0,7}", fullmatch=True)))
def test_every_graph_with_plain_names_is_read_as_it_was_written(graph):
    typed = replace(graph, topics=tuple(replace(topic, type=IMAGE) for topic in graph.topics))
    mapped = map_communication(typed).gateways
    parser = read(build_cfg(mapped))
    assert len(sections(parser, "ReconosThread")) == len(mapped.in_hardware)
    groups = sections(parser, "ResourceGroup").values()
    resources = [re.split(r"[, ]+", value) for group in groups for value in group.values()]
    edges = [edge for edge in mapped.edges() if edge.node in mapped.in_hardware]
    assert sum(args[0] in {"rospub", "rossub"} for args in resources) == len(edges)
