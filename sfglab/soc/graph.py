"""A ROS computation graph with its mapping onto a system-on-chip (paper C, section 5), in memory and as YAML.

G = (V, E) with V = (N, T), ROS nodes and topics, and E = (E_pub, E_sub). Each node is placed in software or in
hardware, each topic is mapped to software, to hardware or to a gateway. What was written is read back equal,
and what was read is written byte by byte the same. Refuses to know which mapping is good.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from sfglab.documents import OR_NULL, ByName, Document
from sfglab.errors import InvalidValueError, KeyPath
from sfglab.fields import between
from sfglab.tables import html_table
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path


class Placement(Enum):
    """Where a ROS node runs: N_SW or N_HW."""

    SOFTWARE = "software"
    HARDWARE = "hardware"


class TopicMapping(Enum):
    """How a topic is implemented: T_SW in main memory, T_HW as a stream in the logic, T_GW as one of each."""

    SOFTWARE = "software"
    HARDWARE = "hardware"
    GATEWAY = "gateway"


class EdgeKind(Enum):
    """Whether an edge stands in E_pub, from a node to a topic, or in E_sub, from a topic to a node."""

    PUBLISH = "publish"
    SUBSCRIBE = "subscribe"


@dataclass(frozen=True, slots=True, kw_only=True)
class Implementation:
    """A node's implementation in the configurable logic."""

    lut: int = between(0)  #: Look-up tables that it takes.
    bram: float = between(
        0.0
    )  #: Block memories of 36 kbit that it takes; a half is one of 18 kbit.
    time_s: float = between(0.0)  #: Time of one activation, s.


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A ROS node."""

    name: str  #: Its name in the graph.
    placement: Placement = Placement.SOFTWARE  #: Where it runs.
    rate_hz: float = between(0.0)  #: Activations per second; 0 where unknown.
    software_s: float = between(0.0)  #: Time of one activation in software, s; 0 where unknown.
    #: Its implementation in hardware; None where there is none, or nothing is known of it.
    hardware: Annotated[Implementation | None, OR_NULL] = None

    @property
    def in_hardware(self) -> bool:
        """Whether it stands in N_HW."""
        return self.placement is Placement.HARDWARE


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A ROS topic with its edges."""

    name: str  #: Its name in the graph.
    publishers: tuple[str, ...]  #: Names of the nodes of E_pub^t.
    subscribers: tuple[str, ...] = ()  #: Names of the nodes of E_sub^t.
    type: str = ""  #: ROS type of its messages; empty where unknown.
    size_bytes: int | None = between(None)  #: Size of a message; None where unknown.
    #: Messages per second of all publishers together; None where unknown.
    rate_hz: float | None = between(None)
    #: How it is implemented; in software unless something else is said, as in the paper.
    mapping: TopicMapping = TopicMapping.SOFTWARE

    @property
    def members(self) -> tuple[str, ...]:
        """The nodes that publish or subscribe, each once."""
        return tuple(dict.fromkeys((*self.publishers, *self.subscribers)))


_Member = TypeVar("_Member", Node, Topic)


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Edge:
    """One edge of E."""

    topic: str  #: Its topic.
    node: str  #: Its node.
    kind: EdgeKind  #: In which direction.

    def __str__(self) -> str:
        ends = (self.node, self.topic) if self.kind is EdgeKind.PUBLISH else (self.topic, self.node)
        return " -> ".join(ends)


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """A computation graph with its mapping, valid from its making on.

    Raises:
        InvalidValueError: A name is empty or stands twice, an edge names a node that there is not or stands
            twice, a topic has no publisher, a number no meaning, or a hardware-mapped topic a node in software.
    """

    #: N, in the order in which they were named.
    nodes: Annotated[tuple[Node, ...], ByName("name")]
    topics: Annotated[tuple[Topic, ...], ByName("name")] = ()  #: T, likewise.
    name: str = ""  #: What it is called.
    description: str = ""  #: Where it comes from and what it is for.

    def __post_init__(self) -> None:
        _check_names("nodes", [node.name for node in self.nodes])
        _check_names("topics", [topic.name for topic in self.topics])
        for node in self.nodes:
            path, hardware = ("nodes", node.name), node.hardware or Implementation()
            _check_not_negative((*path, "rate_hz"), node.rate_hz)
            _check_not_negative((*path, "software_s"), node.software_s)
            for part in fields(hardware):
                _check_not_negative((*path, "hardware", part.name), getattr(hardware, part.name))
        known = {node.name: node for node in self.nodes}
        for topic in self.topics:
            _check_topic(topic, known)

    def __repr__(self) -> str:
        placed = len(self.in_hardware)
        return f"<graph {self.name}: {len(self.nodes)} nodes, {placed} in hardware; {len(self.topics)} topics>"

    def _repr_html_(self) -> str:
        head = "topic", "mapped to", "from", "to", "bytes", "Hz"
        return html_table([head, *map(self._row, self.topics)], repr(self)[1:-1])

    def _row(self, topic: Topic) -> tuple[object, ...]:
        ends = (
            ", ".join(f"{n} (hardware)" if n in self.in_hardware else n for n in names)
            for names in (topic.publishers, topic.subscribers)
        )
        numbers = ("" if n is None else f"{n:,}" for n in (topic.size_bytes, topic.rate_hz))
        return topic.name, topic.mapping.value, *ends, *numbers

    def node(self, name: str) -> Node:
        """Return a node by its name; InvalidValueError where there is none."""
        return _named("nodes", name, self.nodes)

    def topic(self, name: str) -> Topic:
        """Return a topic by its name; InvalidValueError where there is none."""
        return _named("topics", name, self.topics)

    def edges(self) -> Iterator[Edge]:
        """Yield E, topic by topic, publications first."""
        for topic in self.topics:
            for node in topic.publishers:
                yield Edge(topic=topic.name, node=node, kind=EdgeKind.PUBLISH)
            for node in topic.subscribers:
                yield Edge(topic=topic.name, node=node, kind=EdgeKind.SUBSCRIBE)

    @property
    def in_hardware(self) -> frozenset[str]:
        """N_HW; all other nodes stand in N_SW."""
        return frozenset(node.name for node in self.nodes if node.in_hardware)

    def mapped_to(self, mapping: TopicMapping) -> tuple[str, ...]:
        """Return T_SW, T_HW or T_GW, in the graph's order."""
        return tuple(topic.name for topic in self.topics if topic.mapping is mapping)

    def with_mappings(self, mappings: Mapping[str, TopicMapping]) -> Graph:
        """Return the graph with other implementations of topics; InvalidValueError where one cannot be so."""
        for name in mappings:
            self.topic(name)
        topics = tuple(replace(t, mapping=mappings.get(t.name, t.mapping)) for t in self.topics)
        return replace(self, topics=topics)

    def with_placements(self, placements: Mapping[str, Placement]) -> Graph:
        """Return the graph with nodes placed anew, topics in software again; InvalidValueError for no node."""
        for name in placements:
            self.node(name)
        nodes = tuple(replace(n, placement=placements.get(n.name, n.placement)) for n in self.nodes)
        topics = tuple(replace(t, mapping=TopicMapping.SOFTWARE) for t in self.topics)
        return replace(self, nodes=nodes, topics=topics)


def _named(key: str, name: str, members: Iterable[_Member]) -> _Member:
    known = {member.name: member for member in members}
    if name not in known:
        raise _unknown(key, name, known)
    return known[name]


def _unknown(key: str | KeyPath, name: str, known: Iterable[str]) -> InvalidValueError:
    listed = sorted(known)
    some = ", ".join(listed[:12]) + (", ..." if len(listed) > 12 else "")
    return InvalidValueError(
        key, name, f"one of {some}{suggestion(name, listed)}" if listed else "none at all"
    )


def _check_names(key: str, names: list[str]) -> None:
    if "" in names:
        raise InvalidValueError(key, "", "names that are not empty")
    for name, times in Counter(names).items():
        if times > 1:
            raise InvalidValueError(
                (key, name), name, f"each name once, and it is defined {times} times"
            )


def _check_topic(topic: Topic, known: Mapping[str, Node]) -> None:
    path = ("topics", topic.name)
    for part, names in (("publishers", topic.publishers), ("subscribers", topic.subscribers)):
        for name, times in Counter(names).items():
            if name not in known:
                raise _unknown((*path, part), name, known)
            if times > 1:
                allowed = f"each node once, and it stands there {times} times"
                raise InvalidValueError((*path, part), name, allowed)
    if not topic.publishers:
        raise InvalidValueError(
            (*path, "publishers"), None, "at least one node that publishes the topic"
        )
    _check_not_negative((*path, "size_bytes"), topic.size_bytes)
    _check_not_negative((*path, "rate_hz"), topic.rate_hz)
    outside = [name for name in topic.members if not known[name].in_hardware]
    if topic.mapping is TopicMapping.HARDWARE and outside:
        allowed = f"software or gateway, as {outside[0]!r} is placed in software"
        raise InvalidValueError((*path, "mapping"), topic.mapping.value, allowed)


def _check_not_negative(path: KeyPath, value: float | None) -> None:
    if value is not None and not 0 <= value < float("inf"):
        raise InvalidValueError(path, value, "a finite number from 0")


_WIDTH = 110
_RARE_BREAKS = frozenset("\x85\u2028\u2029")


def load_graph(path: Path | str) -> Graph:
    """Read a graph from a YAML file; DocumentError says where it does not say what it must."""
    return read_graph(Document.of_file(path))


def graph_text(graph: Graph) -> str:
    """Return a graph as the text of a YAML file; what has its default value is left out."""
    import yaml

    values = {
        "name": graph.name,
        "description": graph.description,
        "nodes": {node.name: _node_values(node) for node in graph.nodes},
        "topics": {topic.name: _topic_values(topic) for topic in graph.topics},
    }
    values = {key: value for key, value in values.items() if value or key == "nodes"}
    layout: dict[str, Any] = {"sort_keys": False, "default_flow_style": None, "width": _WIDTH}
    return str(yaml.dump(values, Dumper=_dumper(), allow_unicode=True, **layout))


def _dumper() -> Any:
    """Return PyYAML's dumper, which escapes rare line breaks here: raw, it would read them back as blanks."""
    import yaml

    class Dumper(yaml.SafeDumper):
        pass

    def represent(dumper: Dumper, text: str) -> yaml.ScalarNode:
        style = '"' if _RARE_BREAKS.intersection(text) else None
        return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)

    Dumper.add_representer(str, represent)
    return Dumper


def _node_values(node: Node) -> dict[str, Any]:
    hardware = node.hardware
    return {"placement": node.placement.value} | _present(
        rate_hz=float(node.rate_hz) or None,
        software_s=float(node.software_s) or None,
        hardware=hardware
        and {"lut": hardware.lut, "bram": float(hardware.bram), "time_s": float(hardware.time_s)},
    )


def _topic_values(topic: Topic) -> dict[str, Any]:
    return _present(
        type=topic.type or None,
        size_bytes=topic.size_bytes,
        rate_hz=None if topic.rate_hz is None else float(topic.rate_hz),
        publishers=list(topic.publishers),
        subscribers=list(topic.subscribers) or None,
        mapping=None if topic.mapping is TopicMapping.SOFTWARE else topic.mapping.value,
    )


def _present(**values: Any) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def read_graph(document: Document) -> Graph:
    """Read a graph; raises `DocumentError`, as `load_graph`, for what the graph itself refuses too."""
    return document.read(Graph)
