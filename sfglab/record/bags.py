"""Bag as a log: rosbag2 of every ROS 2, a folder or its .db3, and ROS 1's .bag, in MCAP's records.

Knows what `rosbags` reads. Before Iron a bag defined no types: the process's own stand in for them.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from mcap.records import Channel, Message, Schema, Statistics
from mcap.summary import Summary
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v8

from sfglab.messages import UnknownTypeError, definition
from sfglab.record.metadata import QOS_KEY, LogError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from rosbags.interfaces import Connection


class Bag:
    """What an MCAP file and its reader are for a `LogReader`, of a bag; it has no metadata and attachments."""

    def __init__(self, path: Path) -> None:
        self.closed = False  #: Whether it was closed.
        self.summary = Summary()  #: Topics, types and counts.
        self._path = path
        split = path.suffix == ".db3" and (path.parent / "metadata.yaml").is_file()
        with self._reading():
            # AnyReader would refuse a whole rosbag2 for one type that it cannot make, such as one with wstring.
            self._old = AnyReader([path]) if path.suffix == ".bag" else None
            self._bag = self._old or Reader(path.parent if split else path)
            self._bag.open()
        channels, counts = self.summary.channels, {}
        for found in self._bag.connections:
            self.summary.schemas[found.id] = self._schema(found)
            offered = dump_qos_v8(getattr(found.ext, "offered_qos_profiles", []))
            channels[found.id] = Channel(found.id, found.topic, "cdr", {QOS_KEY: offered}, found.id)
            counts[found.id] = found.msgcount
        size, (start, end) = len(channels), (self._bag.start_time, self._bag.end_time - 1)
        self.summary.statistics = Statistics(
            0, size, counts, 0, sum(counts.values()), end, start, 0, size
        )

    def _schema(self, found: Connection) -> Schema:
        text, encoding = found.msgdef.data, f"ros2{found.msgdef.format.name.lower()}"
        if self._old is not None:
            text, encoding = (
                self._old.typestore.generate_msgdef(found.msgtype, ros_version=2)[0],
                "ros2msg",
            )
        elif not text:
            try:
                text, encoding = definition(found.msgtype), "ros2msg"
            except UnknownTypeError:
                encoding = "none: give its package with --interfaces"
        return Schema(found.id, text.encode(), encoding, found.msgtype)

    @contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # rosbags passes on what SQLite, YAML and zstd raise for damage
            raise LogError(
                f"log {self._path}: given what rosbags does not read: {error}"
            ) from error

    def iter_messages(
        self, topic: str | None, *, starting_at: int | None, ending_before: int | None
    ) -> Iterator[tuple[Schema, Channel, Message]]:
        """Yield messages in the order of their times, with their records; of one topic, None: of all."""
        wanted = [found for found in self._bag.connections if topic in (None, found.topic)]
        with self._reading():
            messages = self._bag.messages(wanted, starting_at, ending_before) if wanted else ()
            for found, time_ns, data in messages:
                cdr = self._old.typestore.ros1_to_cdr(data, found.msgtype) if self._old else data
                message = Message(found.id, time_ns, bytes(cdr), time_ns, 0)
                yield self.summary.schemas[found.id], self.summary.channels[found.id], message

    def close(self) -> None:
        """Close it; a second time does nothing."""
        if not self.closed:
            self.closed = True
            self._bag.close()
