"""Reading a log: messages, tables, metadata; also of other recorders, and also when it was cut off.

A log is one MCAP file, one file of a bag, or a rosbag2 folder of several files.
"""

from __future__ import annotations

import difflib
import functools
import heapq
import itertools
import logging
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.messages import decoder, decoder_from_definition
from sfglab.messages.store import is_known, is_known_as
from sfglab.record.bags import open_log
from sfglab.record.mcap_file import McapFile
from sfglab.record.metadata import profile_from_bag, values_from_strings
from sfglab.record.parts import LogError, LogMessage, damage_named, decompress, most_bytes
from sfglab.record.writer import TABLE_PREFIX, TIME_COLUMN
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    import pandas as pd

    from sfglab.qos import QoSProfile
    from sfglab.record.parts import Channel

_LOG = logging.getLogger(__name__)
#: Number of messages of a topic that its rate and size are taken from.
_SAMPLE = 200
_AFTER_ALL_NS = 2**64  # MCAP's times are smaller


class DecodedMessage(NamedTuple):
    """One message, deserialised; the other fields are those of `LogMessage`."""

    topic: str
    type_name: str
    log_time_ns: int
    publish_time_ns: int
    message: Any  #: Arrays are read-only.


def rate_and_size(messages: Sequence[LogMessage]) -> tuple[float, float]:
    """Return the mean rate, Hz, and the mean size, bytes, of a topic's messages; 0 if there are too few."""
    if not messages:
        return 0.0, 0.0
    span_s = (messages[-1].log_time_ns - messages[0].log_time_ns) / NS_PER_S
    size = sum(len(message.cdr) for message in messages) / len(messages)
    return (len(messages) - 1) / span_s if span_s else 0.0, size


class LogReader(AbstractContextManager["LogReader"]):
    """An MCAP file or a bag to read, as a context manager; for one thread at a time.

    A bag is a rosbag2 folder (SQLite or MCAP, also compressed) or its .db3 file, of any ROS 2 distribution.

    A file whose writer was killed, or that is still being written, is read up to its last whole chunk
    at the time of opening; `truncated` is then true. A warning is logged for each other part that cannot be read.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open a file or folder of any recorder and read its index.

        Raises:
            LogError: There is no such file, or it is neither an MCAP file nor a bag.
        """
        self.path = Path(path)  #: The file or folder.
        with ExitStack() as stack:
            self._files, self._is_compressed = open_log(self.path, stack)
            self._stack = stack.pop_all()
        self.files = tuple(file.path for file in self._files)  #: The files that are read.
        #: Whether a file ends before its data does.
        self.truncated = any(file.truncated for file in self._files)
        # Metadata and attached files are in MCAP files only. The last one of a name counts.
        mcap_files = [file for file in self._files if isinstance(file, McapFile)]
        self._metadata = {name: file for file in mcap_files for name in file.metadata}
        self._attachments = {name: file for file in mcap_files for name in file.attachments}
        self._decoder_of = functools.cache(self._decoder)
        channels = [channel for file in self._files for channel in file.channels.values()]
        self._channels: dict[str, list[Channel]] = {}
        for channel in sorted(channels, key=attrgetter("topic")):
            self._channels.setdefault(channel.topic, []).append(channel)

    @cached_property
    def topics(self) -> dict[str, Channel]:
        """The topics in this log, sorted by name, each with the number of all its messages.

        Tables are among them. If the files describe a topic differently, its type is that of the last
        file, and its definition and QoS profiles are the first ones.
        """
        found = {}
        for topic, channels in self._channels.items():
            found[topic] = replace(
                channels[-1],
                count=sum(channel.count for channel in channels),
                definition=_first(channel.definition for channel in channels),
                offered_qos=_first(channel.offered_qos for channel in channels),
            )
        return found

    @property
    def span_ns(self) -> tuple[int, int]:
        """Log times of the first and the last message, ns; zeros without messages."""
        times_ns = [time_ns for file in self._files for time_ns in file.times_ns]
        return min(times_ns, default=0), max(times_ns, default=0)

    def offered_qos(self, topic: str) -> QoSProfile:
        """Return the recorded QoS of a topic's publishers; missing policies have ROS 2's defaults.

        Raises:
            KeyError: There is no such topic in this log.
        """
        return profile_from_bag(self.topics[topic].offered_qos)

    def first(self, topic: str) -> list[LogMessage]:
        """Return a topic's first messages, at most 200, from which its rate and size can be computed.

        Raises:
            LogError: There is no such topic, or the log is damaged or closed.
        """
        return list(itertools.islice(self.messages(topic), _SAMPLE))

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the tables in this log, sorted."""
        return tuple(
            t.removeprefix(TABLE_PREFIX) for t in self.topics if t.startswith(TABLE_PREFIX)
        )

    @property
    def metadata_names(self) -> tuple[str, ...]:
        """Names of the metadata records in this log, in the order of writing."""
        return tuple(self._metadata)

    def metadata(self, name: str) -> dict[str, Any]:
        """Return the values of one metadata record, as `LogWriter.write_metadata` was given them.

        Raises:
            LogError: There is no record with this name, or it is damaged.
        """
        if name not in self._metadata:
            raise _missing(self.path, "metadata", name, self._metadata)
        return values_from_strings(self._metadata[name].strings(name))

    def attachment(self, name: str) -> bytes:
        """Return the content of one attached file, given its name.

        Raises:
            LogError: There is no such file, or it is damaged.
        """
        if name not in self._attachments:
            raise _missing(self.path, "attachment", name, self._attachments)
        return self._attachments[name].attachment(name)

    def messages(
        self, topic: str | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[LogMessage]:
        """Return an iterator over recorded messages in the order of log time, which reads one chunk after the other.

        Args:
            topic: Topic of the messages; None for all topics.
            start_ns: Smallest log time, ns; None for the start of the log.
            end_ns: Log time, ns, that all messages are before; None for the end of the log.

        Raises:
            LogError: There is no such topic; or, during the iteration, a chunk is damaged or the log was closed.
        """
        if topic is not None and topic not in self._channels:
            raise _missing(self.path, "topic", topic, self._channels)
        topics = self._channels if topic is None else [topic]
        channels = [channel for name in topics for channel in self._channels[name]]
        # SQLite does not accept other types of integers, such as NumPy's.
        start = 0 if start_ns is None else int(start_ns)
        end = _AFTER_ALL_NS if end_ns is None else int(end_ns)
        return self._merged(channels, start, end)

    def decoded(self, topic: str) -> Iterator[DecodedMessage]:
        """Return an iterator over the messages of a topic, deserialised, in the order of log time.

        Raises:
            LogError: As for `messages`; during the iteration also as for `decode`.
            CdrError: During the iteration, as for `decode`.
        """
        return (
            DecodedMessage(
                topic,
                entry.type_name,
                entry.log_time_ns,
                entry.publish_time_ns,
                self.decode(entry),
            )
            for entry in self.messages(topic)
        )

    def decode(self, message: LogMessage) -> Any:
        """Return a message of this log, deserialised by the definition in the log.

        Types that this process does not know are read as well. If the definition is the one that sfglab has,
        or the log has none, the message is of the type that `sfglab.messages.message_type` returns.

        Raises:
            LogError: The message is not in CDR, or its type is not known.
            CdrError: The bytes or the definition are damaged.
        """
        return self._decoder_of(message.channel)(message.cdr)

    def knows(self, topic: str) -> bool:
        """Return whether the topic's message type is known in this process with the same fields."""
        return all(is_known_as(c.type_name, c.definition) for c in self._channels.get(topic, ()))

    def table(self, name: str) -> pd.DataFrame:
        """Return a table as a data frame: `log_time_ns` and one column per field, rows in the order of log time.

        Raises:
            LogError: There is no table with this name, or the log is damaged or closed.
        """
        import pandas as pd

        if name not in self.tables:
            raise _missing(self.path, "table", name, self.tables)
        rows = []
        for entry in self.decoded(f"{TABLE_PREFIX}{name}"):
            row = {TIME_COLUMN: entry.log_time_ns, **vars(entry.message)}
            del row["__msgtype__"]
            rows.append(row)
        return pd.DataFrame(rows)

    def close(self) -> None:
        """Close the file; further calls have no effect."""
        self._stack.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _merged(
        self, channels: Sequence[Channel], start_ns: int, end_ns: int
    ) -> Iterator[LogMessage]:
        """Yield the messages of all files in the order of log time; count them if all are asked for."""
        parts = [file.messages(channels, start_ns, end_ns) for file in self._files]
        read = 0
        for message in heapq.merge(*parts, key=attrgetter("log_time_ns")):
            yield self._decompressed(message) if self._is_compressed else message
            read += 1
        expected = sum(channel.count for channel in channels)
        if (start_ns, end_ns) == (0, _AFTER_ALL_NS) and read != expected:
            said = f"the index names {expected} messages, {read} were read"
            _LOG.warning("log %s: %s", self.path, said)

    def _decompressed(self, message: LogMessage) -> LogMessage:
        with damage_named(self.path):
            return message._replace(cdr=decompress(message.cdr, most_bytes(len(message.cdr))))

    def _decoder(self, channel: Channel) -> Callable[[bytes], Any]:
        name = channel.type_name
        if channel.encoding == "cdr":
            if channel.definition and not is_known_as(name, channel.definition):
                return decoder_from_definition(name, channel.definition)
            if is_known(name):
                return decoder(name)
        said = f"given messages {channel.encoding!r}, definition {channel.definition_encoding!r}"
        allowed = "allowed: 'cdr' and 'ros2msg', or types known here and by --interfaces"
        raise LogError(f"log {self.path}: topic {channel.topic}: {said}; {allowed}")


def _first(texts: Iterable[str]) -> str:
    """Return the first text that is not empty."""
    return next(filter(None, texts), "")


def _missing(path: Path, kind: str, name: str, present: Collection[str]) -> LogError:
    near = difflib.get_close_matches(name, present, n=5, cutoff=0)
    there = f"the nearest are {', '.join(near)}" if near else "it has none"
    return LogError(f"log {path}: there is no {kind} {name!r}; {there}")
