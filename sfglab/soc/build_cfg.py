"""A mapped graph as the `build.cfg` that ReconROS builds hardware from.

Knows that file's sections: slots, resources, threads and gateways, as in the demonstration of gateways that
ReconROS carries. Nodes in software are no part of it; they run as ordinary ROS nodes. What a graph does not
say is left to its
user: the sources of the threads, and the board's address and password. Nothing here was built with Vivado.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import Graph, Node, Topic, TopicMapping

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


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
