"""The module `graph` has a ROS computation graph with its mapping onto a system-on-chip, in memory and as a YAML file.

Paper C, section 5, defines the graph as G = (V, E). The vertices V = (N, T) are ROS nodes and topics. The edges
E = (E_pub, E_sub) are publications and subscriptions. Each node is placed in software or in hardware. Each topic is
mapped to software, to hardware or to a gateway. Writing a graph and reading the file again gives an equal graph, and
writing the equal graph gives the same file byte for byte.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from sfglab.documents import OR_NULL, ByName, Document
from sfglab.errors import InvalidValueError, KeyPath
from sfglab.fields import between, to_json
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

Vertex = tuple[str, str]
"""A `Vertex` is ``("node", name)`` or ``("topic", name)``, because a node and a topic may have the same name."""

_SHOWN_NAMES = 12  #: Most names that an error lists.


class Placement(Enum):
    """A `Placement` says whether a ROS node runs in software (N_SW) or in hardware (N_HW)."""

    SOFTWARE = "software"
    HARDWARE = "hardware"


class TopicMapping(Enum):
    """A `TopicMapping` implements a topic in main memory (T_SW), as a stream in the logic (T_HW) or as both (T_GW)."""

    SOFTWARE = "software"
    HARDWARE = "hardware"
    GATEWAY = "gateway"


class EdgeKind(Enum):
    """An `EdgeKind` is the direction of an edge: from a node to a topic (E_pub) or from a topic to a node (E_sub)."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"


@dataclass(frozen=True, slots=True, kw_only=True)
class Implementation:
    """An `Implementation` describes a node in the configurable logic."""

    lut: int = between(0)  #: Number of look-up tables.
    #: Number of block memories of 36 kbit; a block memory of 18 kbit counts as a half.
    bram: float = between(0.0)
    time_s: float = between(0.0)  #: Time of one activation, s.


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A `Node` is a ROS node that runs in software or in hardware."""

    name: str  #: Name in the graph.
    placement: Placement = Placement.SOFTWARE  #: Side on which the node runs.
    rate_hz: float = between(0.0)  #: Activations per second; 0 if unknown.
    software_s: float = between(0.0)  #: Time of one activation in software, s; 0 if unknown.
    #: Implementation in hardware; None if the node has no or no known implementation in hardware.
    hardware: Annotated[Implementation | None, OR_NULL] = None

    @property
    def in_hardware(self) -> bool:
        """Return whether the node runs in hardware (N_HW)."""
        return self.placement is Placement.HARDWARE


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A `Topic` is a ROS topic with its publishers, its subscribers and its mapping."""

    name: str  #: Name in the graph.
    type: str = ""  #: ROS type of the messages; empty if unknown.
    #: Size of a message in bytes; 0 for an empty message; None if unknown.
    size_bytes: int | None = between(None)
    #: Messages per second of all publishers together; None if unknown.
    rate_hz: float | None = between(None)
    publishers: tuple[str, ...]  #: Names of the nodes of E_pub^t.
    subscribers: tuple[str, ...] = ()  #: Names of the nodes of E_sub^t.
    #: Implementation of the topic; software by default, as in the paper.
    mapping: TopicMapping = TopicMapping.SOFTWARE

    @property
    def members(self) -> tuple[str, ...]:
        """Return the names of the nodes that publish or subscribe, each name once."""
        return tuple(dict.fromkeys(self.publishers + self.subscribers))


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """An `Edge` joins a node and a topic of the graph."""

    topic: str  #: Name of the topic.
    node: str  #: Name of the node.
    kind: EdgeKind  #: Direction.

    @property
    def ends(self) -> tuple[Vertex, Vertex]:
        """Return the vertex where the edge begins and the vertex where the edge ends."""
        node, topic = ("node", self.node), ("topic", self.topic)
        return (node, topic) if self.kind is EdgeKind.PUBLISH else (topic, node)

    def __str__(self) -> str:
        (_, source), (_, target) = self.ends
        return f"{source} -> {target}"


_Member = TypeVar("_Member", Node, Topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """A `Graph` is a ROS computation graph with its mapping.

    Raises:
        InvalidValueError: A name is defined twice, an edge names an unknown node or is given twice, a topic has no
            publisher, or a topic in hardware has a node in software.
    """

    #: Nodes N of the graph, in the order of the file.
    nodes: Annotated[tuple[Node, ...], ByName("name")]
    #: Topics T of the graph, in the order of the file.
    topics: Annotated[tuple[Topic, ...], ByName("name")] = ()
    name: str = ""  #: Title of the graph.
    description: str = ""  #: Source and purpose of the graph.

    def __post_init__(self) -> None:
        known = {node.name: node for node in self.nodes}
        _check_names(("nodes",), [node.name for node in self.nodes])
        _check_names(("topics",), [topic.name for topic in self.topics])
        for topic in self.topics:
            _check_topic(topic, known)

    def __repr__(self) -> str:
        nodes = f"{len(self.nodes)} nodes, {len(self.hardware_nodes)} in hardware"
        return f"<graph {self.name}: {nodes}; {len(self.topics)} topics>"

    def node(self, name: str) -> Node:
        """Return the node with a name.

        Raises:
            InvalidValueError: The graph has no such node.
        """
        return _named("nodes", name, self.nodes)

    def topic(self, name: str) -> Topic:
        """Return the topic with a name.

        Raises:
            InvalidValueError: The graph has no such topic.
        """
        return _named("topics", name, self.topics)

    def edges(self) -> Iterator[Edge]:
        """Yield the edges of the graph, topic by topic, with a topic's publications first."""
        for topic in self.topics:
            for node in topic.publishers:
                yield Edge(topic=topic.name, node=node, kind=EdgeKind.PUBLISH)
            for node in topic.subscribers:
                yield Edge(topic=topic.name, node=node, kind=EdgeKind.SUBSCRIBE)

    @property
    def hardware_nodes(self) -> frozenset[str]:
        """Return the names of the nodes in hardware (N_HW)."""
        return frozenset(node.name for node in self.nodes if node.in_hardware)

    def mapped_to(self, mapping: TopicMapping) -> tuple[str, ...]:
        """Return the names of the topics with a mapping (T_SW, T_HW or T_GW), in the graph's order."""
        return tuple(topic.name for topic in self.topics if topic.mapping is mapping)

    def with_mappings(self, mappings: Mapping[str, TopicMapping]) -> Graph:
        """Return the graph in which the named topics have the given mappings.

        Raises:
            InvalidValueError: A topic does not exist, or the topic cannot have the mapping.
        """
        found = {topic.name: topic for topic in self.topics}
        for name, mapping in mappings.items():
            found[name] = replace(self.topic(name), mapping=mapping)
        return replace(self, topics=tuple(found.values()))

    def with_placements(self, placements: Mapping[str, Placement]) -> Graph:
        """Return the graph in which the named nodes have the given placements and all topics are in software.

        Raises:
            InvalidValueError: A node does not exist.
        """
        found = {node.name: node for node in self.nodes}
        for name, placement in placements.items():
            found[name] = replace(self.node(name), placement=placement)
        topics = tuple(replace(topic, mapping=TopicMapping.SOFTWARE) for topic in self.topics)
        return replace(self, nodes=tuple(found.values()), topics=topics)


def _named(key: str, name: str, members: tuple[_Member, ...]) -> _Member:
    for member in members:
        if member.name == name:
            return member
    raise _unknown((key,), name, [member.name for member in members])


def _unknown(path: KeyPath, name: str, known: Iterable[str]) -> InvalidValueError:
    listed = sorted(known)
    more = ", ..." if len(listed) > _SHOWN_NAMES else ""
    allowed = f"one of {', '.join(listed[:_SHOWN_NAMES])}{more}{suggestion(name, listed)}"
    return InvalidValueError(path, name, allowed)


def _check_names(path: KeyPath, names: Iterable[str]) -> None:
    for name, times in Counter(names).items():
        if times > 1:
            raise InvalidValueError(path, name, f"each name once, and it is there {times} times")


def _check_topic(topic: Topic, known: Mapping[str, Node]) -> None:
    path = ("topics", topic.name)
    for key, names in (("publishers", topic.publishers), ("subscribers", topic.subscribers)):
        _check_names((*path, key), names)
        for name in names:
            if name not in known:
                raise _unknown((*path, key), name, known)
    if not topic.publishers:
        allowed = "at least one node that publishes the topic"
        raise InvalidValueError((*path, "publishers"), None, allowed)
    outside = [name for name in topic.members if not known[name].in_hardware]
    if topic.mapping is TopicMapping.HARDWARE and outside:
        allowed = f"software or gateway, as {outside[0]!r} is placed in software"
        raise InvalidValueError((*path, "mapping"), "hardware", allowed)


def load_graph(path: Path | str) -> Graph:
    """Read a graph from a YAML file.

    Raises:
        DocumentError: A value is missing or not allowed; the error names the value's line.
    """
    return Document.of_file(path).read(Graph)


def graph_text(graph: Graph) -> str:
    """Return a graph as the text of a YAML file; the text leaves out values that are equal to their defaults."""
    import yaml

    values: dict[str, Any] = {}
    if graph.name:
        values["name"] = graph.name
    if graph.description:
        values["description"] = graph.description
    values["nodes"] = {}
    for node in graph.nodes:
        values["nodes"][node.name] = {"placement": node.placement.value, **_changed(node)}
    if graph.topics:
        values["topics"] = {topic.name: _changed(topic) for topic in graph.topics}
    # The file has escapes for characters beyond ASCII, because YAML reads some of these characters as line breaks.
    text: str = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=110)
    return text


def _changed(member: Node | Topic) -> dict[str, Any]:
    """Return the fields of a node or topic, except its name, whose values differ from the defaults."""
    changed = {}
    for field in fields(member)[1:]:
        value = getattr(member, field.name)
        if value != field.default:
            changed[field.name] = to_json(value)
    return changed
