"""The module `graph_import` makes a graph from a log, and writes a graph's hardware part as ReconROS's `build.cfg`.

A log does not say where nodes run, so the graph of a log has all nodes in software. A log may be a recording, or the
messages that `sfglab map --domain` received. The file `build.cfg` has the form of ReconROS's demonstration of
gateways. Users add the sources of the threads and the board's address to the file. The project has built no written
`build.cfg` with Vivado.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.record.traffic import COMPUTATION_GRAPH, traffic_of
from sfglab.soc.graph import Graph, Node, Topic, TopicMapping

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab.record import LogReader


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedGraph:
    """An `ImportedGraph` is the graph of a log."""

    graph: Graph  #: Graph of the log, with all nodes in software.
    left_out: dict[str, str]  #: Reason why the graph leaves a topic out, by the topic's name.


def graph_from_log(log: LogReader) -> ImportedGraph:
    """Return the graph of an open log of any recorder; the graph's topics have types, sizes and rates.

    If the log does not name a topic's publishers (`traffic_of`), the graph has one node for this topic, called
    ``publisher of <topic>``, and no subscribers of the topic.

    Raises:
        DocumentError: The metadata record does not have the form that `graph_metadata` returns.
        LogError: The log is damaged.
    """
    topics = []
    left_out = {}
    names: dict[str, None] = {}
    for found in traffic_of(log):
        publishers = found.publishers
        if publishers is None:
            publishers = (f"publisher of {found.topic}",)
        if not publishers:
            left_out[found.topic] = f"no publisher in the record {COMPUTATION_GRAPH!r}"
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
        names |= dict.fromkeys(topic.members)
    nodes = tuple(Node(name=name) for name in names)
    graph = Graph(name=log.path.name, nodes=nodes, topics=tuple(topics))
    return ImportedGraph(graph=graph, left_out=left_out)


#: The board and tools are those of paper C, section 4, as in ReconROS's demonstration of gateways.
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
_CLOCK = {"ClockSource": "static", "ClockFreq": "100000000"}
#: Last argument of a subscription in software, as in all demonstrations of ReconROS.
_TAKE = "10000"


def build_cfg(graph: Graph, *, name: str = "application") -> str:
    """Return the text of `build.cfg` for the hardware part of a placed and mapped graph.

    Each node in hardware gets a slot, a thread with HLS source and the thread's resources; each gateway gets a slot
    and a section. Names of threads and streams become identifiers; ROS names stay unchanged. ReconROS's gateway
    supports only ``sensor_msgs/Image``, but the function writes topics of all types.

    Raises:
        InvalidValueError: A topic has no message type, or a name has a blank, a comma or a quote.
    """
    hardware_nodes = graph.hardware_nodes
    touched = [topic for topic in graph.topics if hardware_nodes.intersection(topic.members)]
    types = {topic.name: _message_type(topic) for topic in touched}
    _check_plain("topics", types)
    threads = _identifiers(node.name for node in graph.nodes if node.in_hardware)
    _check_plain("nodes", threads)
    streams = _identifiers(types)
    gateways = [topic for topic in touched if topic.mapping is TopicMapping.GATEWAY]
    sections = {
        "General": {"Name": _identifiers([name])[name], **_GENERAL},
        "Clock@System": _CLOCK,
    }
    for number, thread in enumerate(threads.values()):
        sections[f"HwSlot@Slot_{thread}(0:0)"] = {"Id": str(number), "Clock": "System"}
    if gateways:
        slots = {"Id": str(len(threads)), "Clock": "System"}
        sections[f"HwSlot@Gateways(0:{len(gateways) - 1})"] = slots
    for node, thread in threads.items():
        resources = {"node": f'rosnode, "{node}"'}
        for topic in touched:
            for side, names in (("pub", topic.publishers), ("sub", topic.subscribers)):
                if node in names:
                    resources |= _resource(side, topic, streams[topic.name], types[topic.name])
        sections[f"ResourceGroup@R_{thread}"] = resources
    for thread in threads.values():
        sections[f"ReconosThread@{thread}"] = {
            "Slot": f"Slot_{thread}(*)",
            "HwSource": "hls",
            "ResourceGroup": f"R_{thread}",
        }
    for number, topic in enumerate(gateways):
        stream = streams[topic.name]
        sections[f"ROSGateway@gateway_{stream}"] = {
            "Slot": f"Gateways({number})",
            "HWTopic": f'"{stream}"',
            "SWTopic": f'"{topic.name}"',
            "MsgType": "/".join(types[topic.name]),
        }
    return _text(sections)


def _text(sections: Mapping[str, Mapping[str, str]]) -> str:
    lines = []
    for title, values in sections.items():
        lines.append(f"[{title}]")
        lines += [f"{key} = {value}" for key, value in values.items()]
        lines.append("")
    return "\n".join(lines)


def _resource(side: str, topic: Topic, stream: str, kind: tuple[str, str]) -> dict[str, str]:
    """Return the entries of a node's publisher or subscription: a message in memory, or a stream in the logic."""
    key = f"{side}_{stream}"
    package, message = kind
    if topic.mapping is not TopicMapping.SOFTWARE:
        return {key: f'ros{side}, node, {package}/{message}, "{stream}", hw'}
    resource = f'ros{side}, node, {key}_msg, "{topic.name}"'
    if side == "sub":
        resource += f", {_TAKE}"
    return {f"{key}_msg": f"rosmsg, {package}, msg, {message}", key: resource}


def _message_type(topic: Topic) -> tuple[str, str]:
    found = re.fullmatch(r"(\w+)/msg/(\w+)", topic.type)
    if found is None:
        allowed = "a ROS message type such as 'sensor_msgs/msg/Image'"
        raise InvalidValueError(("topics", topic.name, "type"), topic.type or None, allowed)
    return found[1], found[2]


def _check_plain(key: str, names: Iterable[str]) -> None:
    """Refuse names with a blank, a comma or a quote, because ReconROS splits a resource's text there even in quotes."""
    for name in names:
        if not re.fullmatch(r'[^\s,"]+', name):
            allowed = "names without blanks, commas and quotes in a build.cfg"
            raise InvalidValueError(key, name, allowed)


def _identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return an identifier for the name of each node and topic.

    Two identifiers differ in more than upper and lower case, because build.cfg names hardware cores by identifiers.
    """
    found: dict[str, str] = {}
    taken = set()
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "x"
        base = plain if plain[0].isalpha() else f"n{plain}"
        identifier = base
        count = 1
        while identifier.lower() in taken:
            count += 1
            identifier = f"{base}_{count}"
        taken.add(identifier.lower())
        found[name] = identifier
    return found
