"""Traffic of the topics of a log: publishers, subscribers, sizes, rates, and times between changes of the value.

The commands `qos` and `map` use it instead of a file that describes the topics.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.record.reader import LogReader, rate_and_size
from sfglab.record.writer import TABLE_PREFIX
from sfglab.validation import read

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.record.parts import LogMessage

COMPUTATION_GRAPH = "computation_graph"
"""Name of the metadata record with the publishers and subscribers of each topic: lists of node names."""

_HEADER_FIRST = re.compile(r"(?:\s*(?:#.*)?\n)*\s*std_msgs/(?:msg/)?Header\s")
_STAMP = slice(4, 12)
"""Bytes of the time stamp in a message that begins with a header: after the four bytes of the CDR header."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Traffic:
    """Traffic of one topic. Numbers are means over its first messages; None: not known."""

    topic: str  #: Name of the topic.
    type_name: str  #: ROS type of its messages.
    publishers: tuple[str, ...] | None  #: Nodes that publish it. None: the log does not name them.
    subscribers: tuple[str, ...] = ()  #: Nodes that subscribe.
    size_bytes: int | None = None  #: Mean size of a serialised message, bytes.
    rate_hz: float | None = None  #: Mean rate, Hz.
    #: Mean time between changes of the value, without the time stamp of a header, s.
    change_s: float | None = None


def traffic_of(log: LogReader) -> Iterator[Traffic]:
    """Yield the traffic of each topic of a log, sorted by name, without the topics of tables.

    Raises:
        InvalidValueError: The record `COMPUTATION_GRAPH` does not have two lists of names for each topic.
        LogError: The log is damaged.
    """
    sides = _sides(log)
    for topic, info in log.topics.items():
        if not topic.startswith(TABLE_PREFIX):
            nodes = sides.get(topic)
            found = log.first(topic)
            rate_hz, size_bytes = rate_and_size(found)
            yield Traffic(
                topic=topic,
                type_name=info.type_name,
                publishers=nodes.publishers if nodes else None,
                subscribers=nodes.subscribers if nodes else (),
                size_bytes=round(size_bytes) if found else None,
                rate_hz=rate_hz or None,
                change_s=_change_s(log, found, rate_hz) if rate_hz else None,
            )


@dataclass(frozen=True, slots=True)
class _Sides:
    """Nodes that publish a topic, and nodes that subscribe to it."""

    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()


def _sides(log: LogReader) -> dict[str, _Sides]:
    if COMPUTATION_GRAPH not in log.metadata_names:
        return {}
    place = f"{log.path.name}: {COMPUTATION_GRAPH}."
    sides: dict[str, _Sides] = read(dict[str, _Sides], log.metadata(COMPUTATION_GRAPH), place)
    return sides


def _change_s(log: LogReader, found: list[LogMessage], rate_hz: float) -> float:
    values = [message.cdr for message in found]
    if _HEADER_FIRST.match(log.topics[found[0].topic].definition):
        values = [value[: _STAMP.start] + value[_STAMP.stop :] for value in values]
    changes = sum(one != other for one, other in pairwise(values))
    return (len(found) - 1) / rate_hz / max(changes, 1)
