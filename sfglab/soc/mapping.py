"""The module `mapping` maps the topics of a graph to software, to hardware or to gateways (paper C, section 5).

The developer, or `sfglab.soc.placement`, places the nodes of the graph first. The function `map_communication` then
maps the topics by the paper's three cases. The function `crossing_edges` finds the edges that cross the boundary
between software and hardware. The function `carriages_per_message` counts how often a message crosses the memory
interface. The functions whose names end in `_s` predict times with the memory model (`sfglab.soc.memory`), for one
message at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import Edge, EdgeKind, Graph, Node, Placement, Topic, TopicMapping
from sfglab.soc.memory import Setup, transfer_times

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


STAGES = ("all topics in software", "topics in hardware", "topics in hardware, gateways")
"""`STAGES` names the three alternative mappings in Fig. 8 b, c and d."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommunicationMapping:
    """A `CommunicationMapping` has the three stages of section 5: alternative mappings of the topics of one graph.

    Each node has the same placement in all three stages.
    """

    all_software: Graph  #: Graph with all topics in software, the default (Fig. 8b).
    #: Graph with topics in hardware if all their nodes are in hardware, other topics in software (Fig. 8c).
    without_gateways: Graph
    gateways: (
        Graph  #: The graph of Fig. 8c with gateways for the topics that the rule selects (Fig. 8d).
    )

    @property
    def stages(self) -> tuple[Graph, Graph, Graph]:
        """Return the three graphs in the order of `STAGES`."""
        return self.all_software, self.without_gateways, self.gateways

    @property
    def crossing(self) -> tuple[int, ...]:
        """Return the number of edges across the boundary in each stage; the paper's example has 10, 8 and 3."""
        return tuple(len(crossing_edges(graph)) for graph in self.stages)

    def __repr__(self) -> str:
        edges = " to ".join(map(str, self.crossing))
        return f"<mapping of {self.gateways.name}: from {edges} edges across the boundary>"


def more_than_one_hardware_subscriber(graph: Graph, topic: Topic) -> bool:
    """Return whether section 5's rule gives a topic a gateway; the rule ignores the size of messages."""
    return len(graph.hardware_nodes.intersection(topic.subscribers)) > 1


def map_communication(
    graph: Graph, *, gateway: Callable[[Graph, Topic], bool] = more_than_one_hardware_subscriber
) -> CommunicationMapping:
    """Map every topic of a graph with placed nodes to software, hardware or a gateway.

    Section 5 has three cases for a topic t:

    1. If all publishers and subscribers of t are in N_SW, t goes to T_SW.
    2. If all publishers and subscribers of t are in N_HW, t goes to T_HW.
    3. If t joins both sides, the rule `gateway` decides whether t goes to T_GW or to T_SW.

    The function ignores the mappings that the given graph has. To map a result again therefore changes nothing.

    Args:
        graph: Graph with placed nodes.
        gateway: Rule for a topic that joins both sides. The rule gets the graph with all topics in software.
    """
    hardware_nodes = graph.hardware_nodes
    all_software = graph.with_placements(
        {}
    )  # The call keeps all placements and maps all topics to software.
    to_hardware: dict[str, TopicMapping] = {}
    to_gateway: dict[str, TopicMapping] = {}
    for topic in all_software.topics:
        if hardware_nodes.issuperset(topic.members):
            to_hardware[topic.name] = TopicMapping.HARDWARE
        elif hardware_nodes.intersection(topic.members) and gateway(all_software, topic):
            to_gateway[topic.name] = TopicMapping.GATEWAY
    without_gateways = all_software.with_mappings(to_hardware)
    return CommunicationMapping(
        all_software=all_software,
        without_gateways=without_gateways,
        gateways=without_gateways.with_mappings(to_gateway),
    )


def crossing_edges(graph: Graph) -> list[Edge]:
    """Return the edges across the boundary between software and hardware, publications first.

    Section 5 counts an edge if the edge's node and topic are on different sides. A topic in software is on the
    software side. A topic in hardware and a gateway are on the hardware side.
    """
    node_sides = {node.name: node.placement for node in graph.nodes}
    topic_sides = dict.fromkeys((topic.name for topic in graph.topics), Placement.HARDWARE)
    topic_sides |= dict.fromkeys(graph.mapped_to(TopicMapping.SOFTWARE), Placement.SOFTWARE)
    crossing = [e for e in graph.edges() if node_sides[e.node] is not topic_sides[e.topic]]
    return sorted(crossing, key=lambda edge: edge.kind is EdgeKind.SUBSCRIBE)


def carriages_per_message(graph: Graph, topic: Topic) -> float:
    """Return how often a message crosses the memory interface, as the mean over the topic's publishers.

    A gateway reduces the number of carriages (section 3); section 5 uses the number of crossing edges in place of the
    number of carriages. A gateway with n subscribers in software has n crossing edges. The gateway still carries a
    message once, because its software subscribers share main memory. On a topic in software each hardware publisher
    writes a message once, and each hardware subscriber reads the message once.
    """
    if topic.mapping is TopicMapping.HARDWARE:
        return 0.0
    if topic.mapping is TopicMapping.GATEWAY:
        return 1.0
    hardware_nodes = graph.hardware_nodes
    writes = len(hardware_nodes.intersection(topic.publishers)) / len(topic.publishers)
    return writes + len(hardware_nodes.intersection(topic.subscribers))


def transfer_s(graph: Graph, topic: Topic, *, side: Placement | None = None) -> float:
    """Return how long a message takes from its publisher to its subscribers as its topic is mapped, s.

    A topic with publishers on both sides takes the time of the slower side. If no subscriber counts, the time is 0 s.

    Args:
        graph: Graph of the topic.
        topic: Topic with its mapping.
        side: Side of the subscribers whose time counts. None: the time until all subscribers have the message.

    Raises:
        InvalidValueError: The size of the messages is unknown.
    """
    size_bytes = message_bytes(topic)
    hardware_nodes = graph.hardware_nodes
    hardware_subscribers = len(hardware_nodes.intersection(topic.subscribers))
    longest_s = 0.0
    for publisher in topic.publishers:
        in_hardware = publisher in hardware_nodes
        setup = Setup(
            publisher=Placement.HARDWARE if in_hardware else Placement.SOFTWARE,
            mapping=topic.mapping,
            message_bytes=size_bytes,
            hardware_subscribers=hardware_subscribers,
            software_subscribers=len(topic.subscribers) - hardware_subscribers,
        )
        times_s = transfer_times(setup)
        counted = times_s.values() if side is None else [times_s.get(side, 0.0)]
        longest_s = max([longest_s, *counted])
    return longest_s


def message_bytes(topic: Topic) -> int:
    """Return the size of a topic's messages in bytes for the memory model; an empty message counts as one byte.

    Raises:
        InvalidValueError: The size of the messages is unknown.
    """
    if topic.size_bytes is None:
        key = ("topics", topic.name, "size_bytes")
        raise InvalidValueError(
            key, None, "the size of a message in bytes, to compute its transfer time"
        )
    return max(topic.size_bytes, 1)


def faster_by_gateway(graph: Graph, topic: Topic) -> bool:
    """Return whether a topic is faster through a gateway by the memory model: a rule for `map_communication`."""
    software = replace(topic, mapping=TopicMapping.SOFTWARE)
    gateway = replace(topic, mapping=TopicMapping.GATEWAY)
    return transfer_s(graph, gateway) < transfer_s(graph, software)


def arrival_s(graph: Graph, edge: Edge) -> float:
    """Return how long a message takes to the node of a subscription as its topic is mapped, s.

    A message to a node in hardware takes the time until the last hardware subscriber has the message. A message to a
    node in software takes the mean time over all orders of delivery.

    Raises:
        InvalidValueError: The size of the messages is unknown.
    """
    return transfer_s(graph, graph.topic(edge.topic), side=graph.node(edge.node).placement)


def chain_s(graph: Graph, chain: Sequence[str]) -> dict[Edge, float]:
    """Return when each next node of a chain has received the message, s, since the first node started its work.

    If the chain uses an edge twice, the result has the later time of the edge.

    Args:
        graph: Graph with its mapping.
        chain: Names of nodes. A topic of known size joins each node to the next node. If such a topic has
            publishers on both sides, the slower side counts.

    Raises:
        InvalidValueError: No topic with a known size joins two nodes of the chain.
    """
    found: dict[Edge, float] = {}
    now_s = 0.0
    for before, after in pairwise(chain):
        edge = link(graph, before, after)
        now_s += activation_s(graph.node(before)) + arrival_s(graph, edge)
        found[edge] = now_s
    return found


def link(graph: Graph, before: str, after: str) -> Edge:
    """Return the edge over which node `after` receives from node `before`; the topic's size must be known.

    Raises:
        InvalidValueError: No topic with a known size joins the nodes.
    """
    for topic in graph.topics:
        is_known = topic.size_bytes is not None
        if before in topic.publishers and after in topic.subscribers and is_known:
            return Edge(topic=topic.name, node=after, kind=EdgeKind.SUBSCRIBE)
    raise InvalidValueError(
        "chain", f"{before}, {after}", "two nodes connected by a topic with size_bytes"
    )


def activation_s(node: Node) -> float:
    """Return the time of one activation of a node on the side where the node is placed, s; 0 if the time is unknown."""
    if not node.in_hardware:
        return node.software_s
    return node.hardware.time_s if node.hardware else 0.0
