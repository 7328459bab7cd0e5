"""The module `recorded` reads the topics of a recorded log or bag for a QoS plan, and writes the file of topics.

A recording has names, sizes, rates, QoS and how often values change. The hosts follow from names, as in the naming
schema (A 4.1): from the namespace of a node, and from the agent or the first segment of a topic. Only the user knows
the link and the weight of a topic; the user adds both to the written file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.arp.topics import Topic
from sfglab.fields import to_json
from sfglab.names.grammar import is_wire_ros_name
from sfglab.record.traffic import Traffic, traffic_of
from sfglab.rtps import Medium

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.qos import QoSProfile
    from sfglab.record import LogReader

_ROBOT, _STATION = "robot", "station"
"""Host of topics whose names contain no host, and host of readers that were not recorded."""

_SCOPES = frozenset({"global", "local"})


def topics_from_log(log: LogReader) -> tuple[tuple[Topic, ...], dict[str, str]]:
    """Return the topics of an open log that go from one host to others, and the reason for each topic left out.

    The largest rate of each topic is the recorded rate.

    Raises:
        DocumentError: The log's record of publishers and subscribers has another form than required.
        LogError: The log is damaged.
    """
    topics, left_out = [], {}
    for found in traffic_of(log):
        usual = host_of(found.topic) or _ROBOT
        sources = {host_of(node) or usual for node in found.publishers or ("",)}
        source = min(sources)
        targets = {host_of(node) or _STATION for node in found.subscribers} - sources
        if why := _obstacle(found, sources, targets):
            left_out[found.topic] = why
        else:
            ways = source, tuple(sorted(targets)) or (_STATION,)
            topics.append(_topic(found, ways, log.offered_qos(found.topic)))
    return tuple(topics), left_out


def _obstacle(found: Traffic, sources: set[str], targets: set[str]) -> str:
    if not is_wire_ros_name(found.topic):
        return "it has no topic name of ROS 2"
    if found.publishers == ():
        return "nobody publishes it"
    if len(sources) > 1:
        return f"more than one host publishes it: {', '.join(sorted(sources))}"
    if found.subscribers and not targets:
        return f"it stays on {min(sources)}"
    if not found.rate_hz or found.size_bytes is None:
        return "it has too few messages to tell a rate"
    return ""


def _topic(found: Traffic, ways: tuple[str, tuple[str, ...]], qos: QoSProfile) -> Topic:
    source, targets = ways
    assert found.rate_hz
    assert found.size_bytes is not None
    assert found.change_s
    rate_hz = float(f"{found.rate_hz:.4g}")
    return Topic(
        name=found.topic,
        source=source,
        target=targets[0] if len(targets) == 1 else targets,
        size_bytes=found.size_bytes,
        rate_min_hz=min(1.0, rate_hz),
        rate_max_hz=rate_hz,
        change_s=float(f"{found.change_s:.4g}"),
        reliability=qos.reliability,
        durability=qos.durability,
    )


def host_of(name: str) -> str:
    """Return the host in a full name, such as go2 for ``/global/go2/camera``; empty if the name has no host."""
    parts = [part for part in name.split("/") if part]
    if parts and parts[0] in _SCOPES:
        del parts[0]
    return parts[0] if len(parts) > 1 else ""


def topics_text(topics: Iterable[Topic], origin: str) -> str:
    """Return the text of a file of topics; the user completes the link and the weights in the file."""
    import yaml

    link = Medium()
    values = {
        "link": {"rate_mbps": link.rate_bps / 1e6, "loss": link.loss},
        "vendor": "fast_dds",
        "topics": {topic.name: _values(topic) for topic in topics},
    }
    return (
        f"# Topics of {origin!r}: rates, sizes, QoS and times between changes are recorded, hosts\n"
        "# follow from names. Say what the link is, and by weight what a topic is worth beside the others.\n"
        + yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120)
    )


def _values(topic: Topic) -> dict[str, Any]:
    to = topic.target if isinstance(topic.target, str) else list(topic.target)
    keys = ("size_bytes", "rate_min_hz", "rate_max_hz", "change_s", "reliability", "durability")
    return {"from": topic.source, "to": to, **{key: to_json(getattr(topic, key)) for key in keys}}
