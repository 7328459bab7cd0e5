"""Communication mapping: which topics go to software, to hardware or to a gateway (paper C, section 5).

The placement of the nodes is given. This module maps the topics by the paper's three cases, finds the edges across
the boundary between software and hardware, and counts how often a message is carried across the memory interface.
With the model of that interface (`sfglab.soc.memory`) it predicts times, for one message at a time, and gives a
rule for gateways that knows the sizes of messages.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import Edge, EdgeKind, Graph, Node, Placement, Topic, TopicMapping
from sfglab.soc.memory import Receiver, Setup, received_s, transfer_times

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


STAGES = ("all topics in software", "topics in hardware", "topics in hardware, gateways")
"""Names of the mappings in Fig. 8 b, c and d."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommunicationMapping:
    """The three stages of section 5; a node has the same placement in each."""

    software: Graph  #: The whole graph with all topics in software, the default (Fig. 8b).
    hardware: Graph  #: Topics that join hardware nodes only in hardware, the others in software (Fig. 8c).
    gateways: Graph  #: In addition gateways where the rule wants them (Fig. 8d): the result.

    @property
    def stages(self) -> tuple[Graph, Graph, Graph]:
        """The three graphs in the order of `STAGES`."""
        return self.software, self.hardware, self.gateways

    @property
    def crossing(self) -> tuple[int, ...]:
        """Number of edges across the boundary in each stage; 10, 8 and 3 in the paper's example."""
        return tuple(len(crossing_edges(graph)) for graph in self.stages)

    def __repr__(self) -> str:
        edges = " to ".join(map(str, self.crossing))
        return f"<mapping of {self.gateways.name}: from {edges} edges across the boundary>"


def more_than_one_hardware_subscriber(graph: Graph, topic: Topic) -> bool:
    """Return whether a topic between both sides gets a gateway: section 5's rule, which knows no sizes."""
    return len(graph.in_hardware.intersection(topic.subscribers)) > 1


def map_communication(
    graph: Graph, *, gateway: Callable[[Graph, Topic], bool] = more_than_one_hardware_subscriber
) -> CommunicationMapping:
    """Map every topic of a graph with placed nodes to software, hardware or a gateway.

    The three cases of section 5, for each topic t:

    1. All publishers and subscribers are in N_SW: t goes to T_SW.
    2. All of them are in N_HW: t goes to T_HW.
    3. Otherwise t joins both sides: t goes to T_GW if the rule `gateway` says so, else to T_SW.

    The mappings of the given graph do not matter, so that mapping a result again changes nothing.
    """
    placed = graph.in_hardware
    software = graph.with_placements({})  # changes no placement, and maps all topics to software
    inside = [topic.name for topic in graph.topics if placed.issuperset(topic.members)]
    hardware = software.with_mappings(dict.fromkeys(inside, TopicMapping.HARDWARE))
    chosen = {}
    for topic in hardware.topics:
        joins_both = topic.name not in inside and placed.intersection(topic.members)
        if joins_both and gateway(hardware, topic):
            chosen[topic.name] = TopicMapping.GATEWAY
    gateways = hardware.with_mappings(chosen)
    return CommunicationMapping(software=software, hardware=hardware, gateways=gateways)


def crossing_edges(graph: Graph) -> list[Edge]:
    """Return the edges across the boundary as section 5 counts them, publications first.

    They are a software topic's edges to hardware nodes, and a gateway's edges to software nodes, because the
    gateway is in hardware. A topic in hardware has none.
    """
    placed = graph.in_hardware
    in_software = graph.mapped_to(TopicMapping.SOFTWARE)
    crossing = [e for e in graph.edges() if (e.node in placed) is (e.topic in in_software)]
    return sorted(crossing, key=lambda edge: edge.kind is EdgeKind.SUBSCRIBE)


def carriages_per_message(graph: Graph, topic: Topic) -> float:
    """Return how often a message is carried across the memory interface, as the mean over publishers.

    This is what a gateway reduces (section 3); the number of edges only stands for it. A gateway with many
    subscribers in software has as many crossing edges, and still carries a message once, because behind it they
    share main memory. In software each hardware publisher writes a message once and each hardware subscriber reads
    it once.
    """
    if topic.mapping is TopicMapping.HARDWARE:
        return 0.0
    if topic.mapping is TopicMapping.GATEWAY:
        return 1.0
    placed = graph.in_hardware
    written = len(placed.intersection(topic.publishers)) / len(topic.publishers)
    return written + len(placed.intersection(topic.subscribers))


def transfer_s(graph: Graph, topic: Topic, *, receiver: Receiver = Receiver.LAST) -> float:
    """Return how long a message takes from its publisher to its subscribers as its topic is mapped, s.

    The receiver says which subscriber's time counts. If publishers are on both sides, the longer time counts.

    Raises:
        InvalidValueError: The size of the messages is unknown.
    """
    size_bytes = message_bytes(topic)
    placed = graph.in_hardware
    hardware = len(placed.intersection(topic.subscribers))
    longest_s = 0.0
    for publisher in topic.publishers:
        setup = Setup(
            publisher=Placement.HARDWARE if publisher in placed else Placement.SOFTWARE,
            mapping=topic.mapping,
            message_bytes=size_bytes,
            hardware=hardware,
            software=len(topic.subscribers) - hardware,
        )
        longest_s = max(longest_s, received_s(transfer_times(setup), receiver))
    return longest_s


def message_bytes(topic: Topic) -> int:
    """Return the size of a topic's messages for the memory model, B; an empty message takes as long as one byte.

    Raises:
        InvalidValueError: The size is unknown.
    """
    if topic.size_bytes is None:
        key = ("topics", topic.name, "size_bytes")
        raise InvalidValueError(key, None, "the size of a message, to know its time")
    return max(topic.size_bytes, 1)


def faster_by_gateway(graph: Graph, topic: Topic) -> bool:
    """Return whether a gateway is predicted to be faster for a topic: a rule for `map_communication`."""
    software = replace(topic, mapping=TopicMapping.SOFTWARE)
    gateway = replace(topic, mapping=TopicMapping.GATEWAY)
    return transfer_s(graph, gateway) < transfer_s(graph, software)


def arrival_s(graph: Graph, edge: Edge) -> float:
    """Return how long a message takes to a subscription's node as its topic is mapped, s.

    A node in hardware counts as the last of the hardware nodes, a node in software as the mean over orders of
    delivery.

    Raises:
        InvalidValueError: The size of the messages is unknown.
    """
    receiver = Receiver.HARDWARE if edge.node in graph.in_hardware else Receiver.SOFTWARE
    return transfer_s(graph, graph.topic(edge.topic), receiver=receiver)


def chain_s(graph: Graph, chain: Sequence[str]) -> dict[Edge, float]:
    """Return when each next node of a chain has the message, s, from the start of the first node's work.

    Args:
        graph: Graph with its mapping.
        chain: Names of nodes; a topic whose size is known goes from each to the next. If such a topic has
            publishers on both sides, the slower side counts.

    Raises:
        InvalidValueError: No such topic joins two nodes.
    """
    found: dict[Edge, float] = {}
    now_s = 0.0
    for before, after in pairwise(chain):
        edge = link(graph, before, after)
        now_s += activation_s(graph.node(before)) + arrival_s(graph, edge)
        found[edge] = now_s
    return found


def link(graph: Graph, before: str, after: str) -> Edge:
    """Return the edge to a node from the topic with a known size that another node publishes to it.

    Raises:
        InvalidValueError: No such topic joins the nodes.
    """
    for topic in graph.topics:
        is_known = topic.size_bytes is not None
        if before in topic.publishers and after in topic.subscribers and is_known:
            return Edge(topic=topic.name, node=after, kind=EdgeKind.SUBSCRIBE)
    raise InvalidValueError("chain", f"{before}, {after}", "nodes that a topic with a size joins")


def activation_s(node: Node) -> float:
    """Return the time of a node's activation on its side, s; 0 if unknown."""
    if not node.in_hardware:
        return node.software_s
    return node.hardware.time_s if node.hardware else 0.0
