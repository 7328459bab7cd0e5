"""Graphs from a recorded log, or of a domain that was listened to, and a graph as what hardware is built from.

No log says where nodes run, so all are placed in software. What cannot stand in a graph is left out and named
with the reason. Built from is ReconROS' `build.cfg`: its slots, resources, threads and gateways, as in the
demonstration of gateways that ReconROS carries; nodes in software run as ordinary ROS nodes. The sources of the
threads, and the board's address and password, are left to the user. Nothing here was built with Vivado.
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
    """A graph and what is missing from it."""

    graph: Graph  #: All nodes in software.
    left_out: dict[str, str]  #: Topics that are not in it, and why.


def graph_from_log(log: LogReader) -> ImportedGraph:
    """Return the graph that an open log of any recorder shows: its topics with types, sizes and rates.

    Where the log does not say who publishes a topic (`traffic_of`), it gets one node of its own, called
    ``publisher of <topic>``, and no subscribers.

    Raises:
        DocumentError: The metadata record is not what `graph_metadata` returns.
        LogError: The log is damaged.
    """
    topics, left_out = [], {}
    for found in traffic_of(log):
        publishers = (
            (f"publisher of {found.topic}",) if found.publishers is None else found.publishers
        )
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
    return ImportedGraph(graph=_graph(topics, log.path.name), left_out=left_out)


def _graph(topics: list[Topic], name: str) -> Graph:
    members = dict.fromkeys(member for topic in topics for member in topic.members)
    return Graph(
        name=name, nodes=tuple(Node(name=member) for member in members), topics=tuple(topics)
    )


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

#: Last argument of a subscription to a software-mapped topic, as in all demonstrations.
_TAKE = "10000"

_TYPE = re.compile(r"(\w+)/msg/(\w+)")
_QUOTED = re.compile(r'[^\s,"]+')


def build_cfg(graph: Graph, *, name: str = "application") -> str:
    """Return the text of an application's `build.cfg` for the part in hardware of a placed and mapped graph.

    Each node in hardware gets a slot, a thread of HLS source and its resources, each gateway a slot and its
    section. Names are made into identifiers; ROS names stay. ReconROS's gateway knows ``sensor_msgs/Image``
    alone; other types are written all the same. A type that is no message's, and a name that cannot be quoted,
    are InvalidValueErrors.
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
                values[f"{side}_{stream}"] = (
                    f'ros{side}, node, {side}_{stream}_msg, "{topic.name}"{take}'
                )
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
