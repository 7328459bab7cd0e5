"""Logs as sources: any MCAP file, and whatever else rosbags reads (rosbag2 directories, ROS 1 bags).

Knows the order of a log; refuses to know what is shown of it.
"""

from __future__ import annotations

import heapq
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.messages import message_types
from sfglab.messages.store import type_store
from sfglab.record import LogReader
from sfglab.view.arrivals import Arrival
from sfglab.view.errors import SourceError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator


class Log:
    """A log to read once or several times; made by `open_log`."""

    @property
    def topics(self) -> dict[str, str]:
        """Type by topic."""
        raise NotImplementedError

    def arrivals(self, topics: Collection[str]) -> Iterator[Arrival]:
        """Yield the messages of some topics in the order in which they were received."""
        raise NotImplementedError


class _Mcap(Log):
    def __init__(self, reader: LogReader) -> None:
        self._reader = reader

    @property
    def topics(self) -> dict[str, str]:
        return {topic: info.type_name for topic, info in self._reader.topics.items()}

    def arrivals(self, topics: Collection[str]) -> Iterator[Arrival]:
        """Types that this process does not know are decoded by the log's own definitions."""
        known = set(message_types())
        foreign = [topic for topic in topics if self.topics.get(topic) not in known]
        sources = [self._foreign(topic) for topic in foreign]
        return heapq.merge(self._ours(set(topics) - set(foreign)), *sources, key=lambda a: a.received_ns)

    def _ours(self, topics: Collection[str]) -> Iterator[Arrival]:
        for entry in self._reader.messages():
            if entry.topic in topics:
                yield Arrival(entry.topic, entry.type_name, entry.log_time_ns, entry.cdr)

    def _foreign(self, topic: str) -> Iterator[Arrival]:
        for entry in self._reader.decoded(topic):
            yield Arrival(topic, entry.type_name, entry.log_time_ns, b"", entry.message)


class _Bag(Log):
    def __init__(self, reader: Any) -> None:
        self._reader = reader

    @property
    def topics(self) -> dict[str, str]:
        return {connection.topic: connection.msgtype for connection in self._reader.connections}

    def arrivals(self, topics: Collection[str]) -> Iterator[Arrival]:
        wanted = [connection for connection in self._reader.connections if connection.topic in topics]
        if not wanted:  # rosbags takes none for all
            return
        for connection, received_ns, data in self._reader.messages(connections=wanted):
            message = self._reader.deserialize(data, connection.msgtype)
            yield Arrival(connection.topic, connection.msgtype, received_ns, b"", message)


@contextmanager
def open_log(path: str | Path) -> Iterator[Log]:
    """Open a log.

    Args:
        path: An MCAP file, also one that was cut off; a rosbag2 directory or its file; a ROS 1 bag.

    Raises:
        LogError: There is no such MCAP file.
        LogError: The MCAP file cannot be read.
        SourceError: Any other cannot be.
    """
    path = Path(path)
    if path.suffix == ".mcap":
        with LogReader(path) as reader:
            yield _Mcap(reader)
        return
    from rosbags.highlevel import AnyReader, AnyReaderError

    bag = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").is_file() else path
    try:
        bag_reader = AnyReader([bag], default_typestore=type_store())
        bag_reader.open()
    except (AnyReaderError, OSError) as error:
        raise SourceError(
            f"log {path}: given what rosbags does not read, allowed an MCAP or a bag: {error}"
        ) from error
    try:
        yield _Bag(bag_reader)
    finally:
        bag_reader.close()
