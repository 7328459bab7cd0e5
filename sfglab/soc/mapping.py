"""Communication mapping: which topics go to software, to hardware, or to a gateway (paper C, section 5).

Node placement is given. The paper's three cases, the edges that cross the boundary, how often a message is
carried across the memory interface, and by its model (`sfglab.soc.memory`) how long that takes, from which
follows a gateway rule that knows sizes. One message at a time has the interface for itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import Edge, EdgeKind, Graph, Node, Topic, TopicMapping
from sfglab.soc.memory import STORED, Costs, Judge, Setup, Side, Transport, judged_s, transfer_times
from sfglab.tables import html_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """Edges that cross the boundary between software and hardware."""

    publications: tuple[Edge, ...]  #: Those of E_pub.
    subscriptions: tuple[Edge, ...]  #: Those of E_sub.

    def __len__(self) -> int:
        return len(self.publications) + len(self.subscriptions)

    def __contains__(self, edge: object) -> bool:
        return edge in self.publications or edge in self.subscriptions


@dataclass(frozen=True, slots=True, kw_only=True)
class CommunicationMapping:
    """The three states of the graph's topics that section 5 walks through."""

    software: Graph  #: All topics in software, the default (Fig. 8b).
    #: Topics among hardware nodes alone in hardware, the others in software (Fig. 8c).
    hardware: Graph
    #: Topics between both sides at gateways where the rule wants it (Fig. 8d): the result.
    gateways: Graph

    @property
    def stages(self) -> tuple[Graph, Graph, Graph]:
        """The three graphs in the paper's order."""
        return self.software, self.hardware, self.gateways

    def __repr__(self) -> str:
        edges = " to ".join(map(str, self.crossing))
        return f"<mapping of {self.gateways.name}: from {edges} edges across the boundary>"

    def _repr_html_(self) -> str:
        rows = [
            (t.name, *(_mapped(graph, t.name) for graph in self.stages))
            for t in self.gateways.topics
        ]
        head = (
            "topic (carried across, times a message)",
            "all in software",
            "topics in hardware",
            "gateways",
        )
        return html_table([head, *rows, ("edges across", *self.crossing)], repr(self)[1:-1])

    @property
    def crossing(self) -> tuple[int, int, int]:
        """Number of edges across the boundary in each; 10, 8 and 3 in the paper's example."""
        first, second, third = (len(crossing_edges(graph)) for graph in self.stages)
        return first, second, third


def _mapped(graph: Graph, name: str) -> str:
    topic = graph.topic(name)
    return f"{topic.mapping.value} ({carriages_per_message(graph, topic):g})"


def more_than_one_hardware_subscriber(graph: Graph, topic: Topic) -> bool:
    """Return whether a topic between both sides gets a gateway: section 5's rule, which knows no sizes."""
    return len(graph.in_hardware.intersection(topic.subscribers)) > 1


def map_communication(
    graph: Graph, *, gateway: Callable[[Graph, Topic], bool] = more_than_one_hardware_subscriber
) -> CommunicationMapping:
    """Map every topic of a graph with placed nodes to software, hardware or a gateway.

    The three cases of section 5, for each topic t:

    1. all publishers and subscribers are in N_SW: t goes to T_SW;
    2. all of them are in N_HW: t goes to T_HW;
    3. else t joins both sides: T_GW where `gateway` says so, or else T_SW, the default.

    How the topics of the given graph are mapped does not matter, so mapping a result again changes nothing.
    """
    placed = graph.in_hardware
    software = graph.with_mappings({topic.name: TopicMapping.SOFTWARE for topic in graph.topics})
    inside = [topic.name for topic in graph.topics if placed.issuperset(topic.members)]
    hardware = software.with_mappings(dict.fromkeys(inside, TopicMapping.HARDWARE))
    chosen = {
        topic.name: TopicMapping.GATEWAY
        for topic in hardware.topics
        if topic.name not in inside
        and placed.intersection(topic.members)
        and gateway(hardware, topic)
    }
    return CommunicationMapping(
        software=software, hardware=hardware, gateways=hardware.with_mappings(chosen)
    )


def crossing_edges(graph: Graph) -> Crossing:
    """Return the edges across the boundary, as section 5 counts them; a topic in hardware has none.

    Of a topic in software they are those of nodes in hardware, of a gateway those of nodes in software.
    """
    placed = graph.in_hardware
    beside = {topic.name: topic.mapping is not TopicMapping.SOFTWARE for topic in graph.topics}
    found = [edge for edge in graph.edges() if (edge.node in placed) is not beside[edge.topic]]
    return Crossing(
        publications=tuple(edge for edge in found if edge.kind is EdgeKind.PUBLISH),
        subscriptions=tuple(edge for edge in found if edge.kind is EdgeKind.SUBSCRIBE),
    )


def carriages_per_message(graph: Graph, topic: Topic) -> float:
    """Return how often a message is carried across the memory interface, the mean over publishers.

    This is what a gateway reduces (section 3); edges only stand for it. A gateway with many subscribers in
    software has as many crossing edges, and still carries a message once: behind it they share main memory.
    In software each hardware publisher writes a message once and each hardware subscriber reads it once.
    """
    if topic.mapping is TopicMapping.HARDWARE:
        return 0.0
    if topic.mapping is TopicMapping.GATEWAY:
        return 1.0
    placed = graph.in_hardware
    written = len(placed.intersection(topic.publishers)) / len(topic.publishers)
    return written + len(placed.intersection(topic.subscribers))


def hardware_subgraphs(graph: Graph) -> tuple[tuple[frozenset[str], frozenset[str]], ...]:
    """Return each part that is joined inside the logic, outlined in Fig. 8: its nodes and its topics."""
    placed = graph.in_hardware
    parts: list[tuple[set[str], set[str]]] = [({name}, set()) for name in sorted(placed)]
    for topic in graph.topics:
        if topic.mapping is TopicMapping.SOFTWARE:
            continue
        members = placed.intersection(topic.members)
        joined = [part for part in parts if part[0] & members]
        parts = [part for part in parts if not part[0] & members]
        nodes: set[str] = set().union(*(part[0] for part in joined))
        topics = {topic.name}.union(*(part[1] for part in joined))
        parts.append((nodes, topics))
    return tuple((frozenset(nodes), frozenset(topics)) for nodes, topics in parts)


_TRANSPORTS = {
    TopicMapping.SOFTWARE: Transport.SMT,
    TopicMapping.HARDWARE: Transport.HMT,
    TopicMapping.GATEWAY: Transport.GATEWAY,
}


def transfer_s(
    graph: Graph, topic: Topic, *, judge: Judge = Judge.LAST, costs: Costs = STORED
) -> float:
    """Return how long a message takes from its publisher to its subscribers as its topic is mapped, s.

    The judge says which subscriber's time counts; of publishers on both sides it is the longer one's. Raises
    InvalidValueError where the topic's size is unknown.
    """
    return max(
        judged_s(transfer_times(setup, costs), setup, judge) for setup in _setups(graph, topic)
    )


def arrival_s(graph: Graph, edge: Edge, *, costs: Costs = STORED) -> float:
    """Return how long a message takes to a subscription's node as its topic is mapped, s.

    A node in hardware is counted as the last of those, one in software in the mean over orders of delivery.

    Raises:
        InvalidValueError: The topic's size is unknown.
    """
    topic = graph.topic(edge.topic)
    judge = Judge.HARDWARE if edge.node in graph.in_hardware else Judge.SOFTWARE
    return transfer_s(graph, topic, judge=judge, costs=costs)


def chain_s(graph: Graph, chain: Sequence[str], *, costs: Costs = STORED) -> dict[Edge, float]:
    """Return when the next node of a chain has the message, s, from the start of the first node's work.

    Work is that of a node's activation where it is placed. A topic without a size is no part of a chain;
    InvalidValueError where none goes from a node to the next.
    """
    found: dict[Edge, float] = {}
    now_s = 0.0
    for before, after in pairwise(map(graph.node, chain)):
        ways = (
            t for t in graph.topics if before.name in t.publishers and after.name in t.subscribers
        )
        way = next((topic.name for topic in ways if topic.size_bytes), None)
        if way is None:
            pair = f"{before.name}, {after.name}"
            raise InvalidValueError("chain", pair, "nodes that a topic with a size joins")
        edge = Edge(topic=way, node=after.name, kind=EdgeKind.SUBSCRIBE)
        now_s += activation_s(before) + arrival_s(graph, edge, costs=costs)
        found[edge] = now_s
    return found


def activation_s(node: Node) -> float:
    """Return the time of a node's activation where it is placed, s; 0 where unknown."""
    if not node.in_hardware:
        return node.software_s
    return node.hardware.time_s if node.hardware else 0.0


def faster_by_gateway(
    *, judge: Judge = Judge.LAST, costs: Costs = STORED
) -> Callable[[Graph, Topic], bool]:
    """Return a rule for `map_communication`: a gateway where it is predicted to be faster; see `transfer_s`."""

    def rule(graph: Graph, topic: Topic) -> bool:
        software, gateway = (
            transfer_s(graph, replace(topic, mapping=mapping), judge=judge, costs=costs)
            for mapping in (TopicMapping.SOFTWARE, TopicMapping.GATEWAY)
        )
        return gateway < software

    return rule


def _setups(graph: Graph, topic: Topic) -> list[Setup]:
    """Return the model's view of a topic, once for each side from which it is published."""
    if topic.size_bytes is None:
        key = f"topics.{topic.name}.size_bytes"
        raise InvalidValueError(key, None, "the size of a message, to know its time")
    placed = graph.in_hardware
    hardware = len(placed.intersection(topic.subscribers))
    sides = {Side.HARDWARE if name in placed else Side.SOFTWARE: None for name in topic.publishers}
    return [
        Setup(
            publisher=side,
            transport=_TRANSPORTS[topic.mapping],
            message_bytes=max(topic.size_bytes, 1),
            hardware=hardware,
            software=len(topic.subscribers) - hardware,
        )
        for side in sides
    ]
