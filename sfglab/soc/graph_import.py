"""Graphs from a recorded log or the live graph of a DDS domain, and a graph as what hardware is built from.

Neither says where nodes run, so all of them are placed in software. What cannot stand in a graph is left out
and named with the reason. Knows logs and endpoints. Refuses to know what is done with a graph.

Built from is ReconROS' `build.cfg`: its slots, resources, threads and gateways, as in the demonstration of
gateways that ReconROS carries. Nodes in software are no part of it; they run as ordinary ROS nodes. What a
graph does not say is left to its user: the sources of the threads, and the board's address and password.
Nothing here was built with Vivado.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.record.traffic import COMPUTATION_GRAPH, traffic_of
from sfglab.soc.graph import Graph, Node, Topic, TopicMapping

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab import bus
    from sfglab.bus import EndpointInfo
    from sfglab.record import LogReader


_ROS_OWN = frozenset({"/rosout", "/parameter_events"})


@dataclass(frozen=True, slots=True, kw_only=True)
class LeftOut:
    """A topic that is not in the graph."""

    topic: str  #: Its name.
    why: str  #: Why not.


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedGraph:
    """A graph and what is missing from it."""

    graph: Graph  #: All nodes in software.
    left_out: tuple[LeftOut, ...] = ()  #: Topics that are not in it.


def graph_metadata(graph: Graph) -> dict[str, Any]:
    """Return the values of the record `COMPUTATION_GRAPH`, to be written into a log beside its messages.

    A log's channels say what was published, but not by whom; `graph_from_log` reads that from this record.
    """
    return {
        topic.name: {"publishers": list(topic.publishers), "subscribers": list(topic.subscribers)}
        for topic in graph.topics
    }


def graph_from_log(log: LogReader) -> ImportedGraph:
    """Return the graph that an open log of any recorder shows: its topics with types, sizes and rates.

    Where the log does not say who publishes a topic (`traffic_of`), it gets one node of its own, called
    ``publisher of <topic>``, and no subscribers.

    Raises:
        DocumentError: The metadata record is not what `graph_metadata` returns.
        LogError: The log is damaged.
    """
    topics, left_out = [], []
    for found in traffic_of(log):
        publishers = (f"publisher of {found.topic}",) if found.publishers is None else found.publishers
        if not publishers:
            left_out.append(LeftOut(topic=found.topic, why=f"no publisher in the record {COMPUTATION_GRAPH!r}"))
            continue
        topic = Topic(
            name=found.topic,
            type=found.type_name,
            size_bytes=found.size_bytes,
            rate_hz=found.rate_hz,
            publishers=publishers,
            subscribers=found.subscribers,
        )
        topics.append(topic)
    return ImportedGraph(graph=_graph(topics, log.path.name), left_out=tuple(left_out))


def graph_from_endpoints(endpoints: Iterable[EndpointInfo], *, name: str = "") -> ImportedGraph:
    """Return the graph, called `name`, of some endpoints, such as those of `sfglab.bus.Graph.endpoints`.

    Nodes have the names by which their participants announce them; an endpoint whose owner is unknown belongs
    to a node named after its participant. Services, and the topics that every ROS node has, are no part of
    the graph; sizes and rates are unknown.
    """
    from sfglab.bus import EndpointKind

    types: dict[str, set[str]] = defaultdict(set)
    sides: dict[EndpointKind, dict[str, set[str]]] = {kind: defaultdict(set) for kind in EndpointKind}
    for endpoint in endpoints:
        if endpoint.dds_topic.startswith("rt/") and endpoint.topic not in _ROS_OWN:
            types[endpoint.topic].add(endpoint.type)
            owner = endpoint.node or f"participant {endpoint.participant.hex()}"
            sides[endpoint.kind][endpoint.topic].add(owner)
    topics, left_out = [], []
    for topic, kinds in sorted(types.items()):
        publishers = tuple(sorted(sides[EndpointKind.PUBLISHER][topic]))
        subscribers = tuple(sorted(sides[EndpointKind.SUBSCRIPTION][topic]))
        if why := _obstacle(publishers, kinds):
            left_out.append(LeftOut(topic=topic, why=why))
            continue
        topics.append(Topic(name=topic, type=min(kinds), publishers=publishers, subscribers=subscribers))
    return ImportedGraph(graph=_graph(topics, name), left_out=tuple(left_out))


async def watch_graph(node: bus.Node, *, timeout_s: float = 5.0) -> ImportedGraph:
    """Return the graph that a node of the bus sees, once the owner of every topic's endpoints is known.

    The open node's own topics are part of it. After `timeout_s` seconds, owners that are still unknown stay
    so.
    """
    seen = node.graph
    seen.nodes()  # from now on owners are learnt
    await seen.wait_for(
        lambda: (
            bool(seen.endpoints())
            and all(endpoint.node for endpoint in seen.endpoints() if endpoint.dds_topic.startswith("rt/"))
        ),
        timeout_s,
    )
    return graph_from_endpoints(seen.endpoints(), name=f"seen by {node.name}")


def _obstacle(publishers: tuple[str, ...], types: set[str]) -> str:
    if not publishers:
        return "nobody publishes it"
    if len(types) > 1:
        return f"it has more than one type: {', '.join(sorted(types))}"
    return ""


def _graph(topics: list[Topic], name: str) -> Graph:
    members = dict.fromkeys(member for topic in topics for member in topic.members)
    return Graph(name=name, nodes=tuple(Node(name=member) for member in members), topics=tuple(topics))


_GENERAL = {
    "TargetBoard": "zcu104,0",
    "TargetPart": "xczu7ev-ffvc1156-2-e",
    "CPUArchitecture": "arm64",
    "ROS2Distribution": "galactic",
    "ReferenceDesign": "hwtopics",
    "TargetOS": "linux64",
    "TargetXil": "vivado,2021.2",
    "TargetHls": "vivado,2021.2",
    "SystemClock": "System",
}
"""The setup of paper C, section 4, as ReconROS's own demonstration of gateways has it."""

_CLOCK = {"ClockSource": "static", "ClockFreq": "100000000"}

_TAKE = "10000"  #: Last argument of a subscription to a software-mapped topic, as in all demonstrations.

_TYPE = re.compile(r"(\w+)/msg/(\w+)")
_QUOTED = re.compile(r'[^\s,"]+')


def build_cfg(graph: Graph, *, name: str = "application") -> str:
    """Return the text of an application's `build.cfg` for the part in hardware of a placed and mapped graph.

    Each node in hardware gets a slot, a thread of HLS source and its resources, each gateway a slot and its
    section. Names are made into identifiers; ROS names of nodes and topics stay as they are. ReconROS's
    gateway knows ``sensor_msgs/Image`` alone; other types are written all the same.

    Raises:
        InvalidValueError: A topic of a node in hardware has no ROS message type, or a name cannot be quoted.
    """
    placed = [node for node in graph.nodes if node.in_hardware]
    touched = [topic for topic in graph.topics if graph.in_hardware.intersection(topic.members)]
    for topic in touched:
        _message_type(topic)
        _check_name("topics", topic.name)
    threads = _identifiers(node.name for node in placed)
    streams = _identifiers(topic.name for topic in touched)
    sections = [_section("General", {"Name": _identifiers([name])[name], **_GENERAL})]
    sections.append(_section("Clock@System", _CLOCK))
    sections += _slots(threads, len(graph.mapped_to(TopicMapping.GATEWAY)))
    sections += [_resources(node, threads[node.name], touched, streams) for node in placed]
    sections += [_thread(threads[node.name]) for node in placed]
    gateways = [topic for topic in touched if topic.mapping is TopicMapping.GATEWAY]
    sections += [_gateway(topic, i, streams[topic.name]) for i, topic in enumerate(gateways)]
    return "\n".join(sections)


def _section(title: str, values: Mapping[str, str]) -> str:
    return "\n".join([f"[{title}]", *(f"{key} = {value}" for key, value in values.items())]) + "\n"


def _slots(threads: Mapping[str, str], gateways: int) -> list[str]:
    slots = [
        _section(f"HwSlot@Slot_{thread}(0:0)", {"Id": str(i), "Clock": "System"})
        for i, thread in enumerate(threads.values())
    ]
    if gateways:
        title = f"HwSlot@Gateways(0:{gateways - 1})"
        slots.append(_section(title, {"Id": str(len(threads)), "Clock": "System"}))
    return slots


def _resources(node: Node, thread: str, topics: Iterable[Topic], streams: Mapping[str, str]) -> str:
    """A software-mapped topic has a message in main memory, a hardware-mapped one the name of its stream."""
    _check_name("nodes", node.name)
    values = {"node": f'rosnode, "{node.name}"'}
    for topic in topics:
        package, kind = _message_type(topic)
        stream = streams[topic.name]
        for side, members in (("pub", topic.publishers), ("sub", topic.subscribers)):
            if node.name not in members:
                continue
            if topic.mapping is TopicMapping.SOFTWARE:
                values[f"{side}_{stream}_msg"] = f"rosmsg, {package}, msg, {kind}"
                take = f", {_TAKE}" if side == "sub" else ""
                values[f"{side}_{stream}"] = f'ros{side}, node, {side}_{stream}_msg, "{topic.name}"{take}'
            else:
                values[f"{side}_{stream}"] = f'ros{side}, node, {package}/{kind}, "{stream}", hw'
    return _section(f"ResourceGroup@R_{thread}", values)


def _thread(thread: str) -> str:
    values = {"Slot": f"Slot_{thread}(*)", "HwSource": "hls", "ResourceGroup": f"R_{thread}"}
    return _section(f"ReconosThread@{thread}", values)


def _gateway(topic: Topic, number: int, stream: str) -> str:
    package, kind = _message_type(topic)
    values = {
        "Slot": f"Gateways({number})",
        "HWTopic": f'"{stream}"',
        "SWTopic": f'"{topic.name}"',
        "MsgType": f"{package}/{kind}",
    }
    return _section(f"ROSGateway@gateway_{stream}", values)


def _message_type(topic: Topic) -> tuple[str, str]:
    found = _TYPE.fullmatch(topic.type)
    if found is None:
        allowed = "a ROS message type such as 'sensor_msgs/msg/Image'"
        raise InvalidValueError(f"topics.{topic.name}.type", topic.type or None, allowed)
    return found[1], found[2]


def _check_name(key: str, name: str) -> None:
    """ReconROS splits a resource's arguments at commas and blanks, quoted or not."""
    if not _QUOTED.fullmatch(name):
        raise InvalidValueError(key, name, "names without blanks, commas and quotes in a build.cfg")


def _identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return an identifier for each name; all differ, also in one case, as names of cores have."""
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "x"
        base = plain if plain[0].isalpha() else f"n{plain}"
        count, identifier = 1, base
        while identifier.lower() in taken:
            count += 1
            identifier = f"{base}_{count}"
        taken.add(identifier.lower())
        found[name] = identifier
    return found
