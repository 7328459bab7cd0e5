"""Reading a log: messages, tables, metadata; also of other recorders, and also when it was cut off.

A log is one MCAP file, one file of a bag, or a rosbag2 folder of several files.
"""

from __future__ import annotations

import difflib
import heapq
import itertools
import logging
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from zstandard import ZstdError

from sfglab.messages import decoder, decoder_from_definition
from sfglab.messages.store import is_known, is_known_as
from sfglab.record.bags import open_log
from sfglab.record.mcap_file import McapFile
from sfglab.record.metadata import profile_from_bag, values_from_strings
from sfglab.record.parts import LogError
from sfglab.record.writer import TABLE_PREFIX, TIME_COLUMN
from sfglab.record.zstd import decompress
from sfglab.tables import html_table
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import pandas as pd

    from sfglab.qos import QoSProfile
    from sfglab.record.parts import Channel, StoredMessage

_LOG = logging.getLogger(__name__)
#: Number of messages of a topic that its rate and size are taken from.
_SAMPLE = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """Contents of one topic of a log."""

    type_name: str  #: ROS type of the messages.
    count: int  #: Number of messages.
    encoding: str = "cdr"  #: Encoding of the messages.


class LogMessage(NamedTuple):
    """One message as it was recorded."""

    topic: str  #: Name of the topic.
    type_name: str  #: ROS type.
    log_time_ns: int  #: Time of reception, on the clock of the run.
    publish_time_ns: int  #: Time of publication, on the same clock.
    cdr: bytes  #: Serialised message.


class DecodedMessage(NamedTuple):
    """One message, deserialised; fields as of `LogMessage`."""

    topic: str
    type_name: str
    log_time_ns: int
    publish_time_ns: int
    message: Any  #: Arrays are read-only.


def rate_and_size(messages: Sequence[LogMessage]) -> tuple[float, float]:
    """Return rate [Hz] and mean size [bytes] of a topic's messages; 0 if there are too few."""
    span_s = (messages[-1].log_time_ns - messages[0].log_time_ns) / NS_PER_S if messages else 0
    size = sum(len(message.cdr) for message in messages) / max(1, len(messages))
    return (len(messages) - 1) / span_s if span_s > 0 else 0.0, size


class LogReader(AbstractContextManager["LogReader"]):
    """An MCAP file or a bag to read, as a context manager; for one thread at a time.

    A bag is a rosbag2 folder (SQLite or MCAP, also compressed) or its .db3 file, of any ROS 2.

    A file whose writer was killed, or that is still being written, is read up to its last whole chunk
    at the time of opening; `truncated` is then true.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open a file or folder of any recorder and read its index.

        Raises:
            LogError: There is no such file, or it is neither an MCAP file nor a bag.
        """
        self.path = Path(path)  #: The file or folder.
        self._decoders: dict[Channel, Callable[[bytes], Any]] = {}
        self._closed = False
        self._stack = ExitStack()
        with ExitStack() as stack:
            opened = open_log(self.path, stack)
            self._stack = stack.pop_all()
        self.files = tuple(opened.paths)  #: The files that are read.
        #: Sentences on what cannot be read or was counted otherwise.
        self.warnings: list[str] = []
        for warning in opened.warnings:
            self._warn(warning)
        self._files = opened.files
        # Metadata and attached files are in MCAP files only.
        self._mcap_files = [file for file in self._files if isinstance(file, McapFile)]
        self._compressed = opened.compressed_messages
        self._channels = tuple(channel for file in self._files for channel in file.channels)
        #: Whether a file ends before its data does.
        self.truncated = any(file.truncated for file in self._files)

    @cached_property
    def topics(self) -> dict[str, TopicInfo]:
        """The topics in this log, sorted by name; tables are among them."""
        found: dict[str, TopicInfo] = {}
        for channel in sorted(self._channels, key=attrgetter("topic")):
            before = found[channel.topic].count if channel.topic in found else 0
            found[channel.topic] = TopicInfo(
                type_name=channel.type_name,
                count=before + channel.count,
                encoding=channel.encoding,
            )
        return found

    @property
    def span_ns(self) -> tuple[int, int]:
        """Log times [ns] of the first and the last message; zeros without messages."""
        spans = [file.span_ns for file in self._files if file.span_ns is not None]
        if not spans:
            return 0, 0
        return min(first for first, _ in spans), max(last for _, last in spans)

    def offered_qos(self, topic: str) -> QoSProfile:
        """Return the recorded profile of a topic's publishers; what is left open is ROS 2's default."""
        texts = [channel.offered_qos for channel in self._channels_of(topic)]
        return profile_from_bag("\n".join(filter(None, texts)))

    def definition(self, topic: str) -> str:
        """Return the definition of a topic's type in the log; empty where it has none as `.msg`."""
        for channel in self._channels_of(topic):
            if channel.definition_encoding == "ros2msg":
                return self._text_of(channel)
        return ""

    @property
    def media_types(self) -> dict[str, str]:
        """The attached files in this log with their media types, in the order of writing."""
        found: dict[str, str] = {}
        for file in self._mcap_files:
            found |= file.media_types()
        return found

    def __repr__(self) -> str:
        cut = ", cut off" if self.truncated else ""
        count = sum(info.count for info in self.topics.values())
        return f"<log {self.path.name}: {count} messages of {len(self.topics)} topics{cut}>"

    def _repr_html_(self) -> str:
        text = repr(self)[1:-1]
        if self.metadata_names:
            text += f"; metadata: {', '.join(self.metadata_names)}"
        if self.attachment_names:
            text += f"; attached: {', '.join(self.attachment_names)}"
        return html_table(self.overview(), text)

    def overview(self) -> list[tuple[str, ...]]:
        """Return a header and a row for each topic: type, count, and rate and mean size of its first messages."""
        rows: list[tuple[str, ...]] = [("topic", "type", "messages", "Hz", "bytes")]
        for topic, info in self.topics.items():
            rate_hz, size = rate_and_size(self.first(topic))
            shown = f"{rate_hz:.3g}" if rate_hz else "", f"{size:.0f}" if info.count else ""
            rows.append((topic, info.type_name, str(info.count), *shown))
        return rows

    def first(self, topic: str) -> list[LogMessage]:
        """Return a topic's first messages, at most 200: enough for its rate and size."""
        return list(itertools.islice(self.messages(topic), _SAMPLE))

    @property
    def tables(self) -> tuple[str, ...]:
        """The names of the tables in this log, sorted."""
        return tuple(
            t.removeprefix(TABLE_PREFIX) for t in self.topics if t.startswith(TABLE_PREFIX)
        )

    @property
    def metadata_names(self) -> tuple[str, ...]:
        """The names of the metadata records in this log, in the order of writing."""
        return tuple(dict.fromkeys(name for file in self._mcap_files for name in file.metadata()))

    @property
    def attachment_names(self) -> tuple[str, ...]:
        """The names of the attached files in this log, in the order of writing."""
        return tuple(self.media_types)

    def metadata(self, name: str) -> dict[str, Any]:
        """Return one metadata record as it was written; LogError if there is none of that name."""
        self._check_open()
        for file in self._mcap_files:
            records = file.metadata()
            if name in records:
                return values_from_strings(records[name])
        raise _missing("metadata", name, self.metadata_names)

    def attachment(self, name: str) -> bytes:
        """Return the content of one attached file, by its name; LogError if there is none."""
        self._check_open()
        for file in self._mcap_files:
            if name in file.media_types():
                return bytes(file.attachment(name))
        raise _missing("attachment", name, self.attachment_names)

    def messages(
        self, topic: str | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[LogMessage]:
        """Return the recorded messages in the order of their log times; a chunk is read when its turn comes.

        Only those of a topic, None: of all; from `start_ns` on and before `end_ns`, log times in nanoseconds.
        Raises LogError where there is no such topic, or the end lies before the start, or while iterating: a
        chunk is damaged, or the log was closed.
        """
        return (
            LogMessage(c.topic, c.type_name, log_ns, publish_ns, data)
            for c, log_ns, publish_ns, data in self._found(topic, start_ns, end_ns)
        )

    def decoded(
        self, topic: str, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[DecodedMessage]:
        """Return the messages of a topic, deserialised by the definition in the log; arguments of `messages`.

        Types that this process does not know are read as well. Where the definition is the one that sfglab has,
        or the log has none, the messages are of the type that `sfglab.messages.message_type` returns. Raises
        LogError as `messages`, and while iterating where something is no CDR or no text, CdrError where bytes
        or definition are of no use.
        """
        return (
            DecodedMessage(c.topic, c.type_name, log_ns, publish_ns, self._decoder(c)(data))
            for c, log_ns, publish_ns, data in self._found(topic, start_ns, end_ns)
        )

    def knows(self, topic: str) -> bool:
        """Return whether this process has the type of a topic's messages with the same fields."""
        channels = self._channels_of(topic)
        return all(is_known_as(c.type_name, self._text_of(c)) for c in channels)

    def table(self, name: str) -> pd.DataFrame:
        """Return a table of `log_time_ns` and fields in the order of log times; LogError as `metadata`."""
        import pandas as pd

        if name not in self.tables:
            raise _missing("table", name, self.tables)
        rows = []
        for entry in self.decoded(f"{TABLE_PREFIX}{name}"):
            row = {TIME_COLUMN: entry.log_time_ns, **vars(entry.message)}
            del row["__msgtype__"]
            rows.append(row)
        return pd.DataFrame(rows)

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        self._closed = True
        self._stack.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._closed:
            raise LogError(f"log {self.path}: it is closed")

    def _channels_of(self, topic: str) -> list[Channel]:
        return [channel for channel in self._channels if channel.topic == topic]

    def _found(
        self, topic: str | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[StoredMessage]:
        topics = self.topics
        if topic is not None and topic not in topics:
            near = tuple(difflib.get_close_matches(topic, topics, n=5, cutoff=0)) or tuple(topics)
            raise _missing("topic", topic, near)
        if start_ns is not None and end_ns is not None and end_ns < start_ns:
            raise LogError(
                f"log {self.path}: the end {end_ns} ns lies before the start {start_ns} ns"
            )
        channels = self._channels if topic is None else self._channels_of(topic)
        return self._merged(channels, start_ns, end_ns)

    def _merged(
        self, channels: Sequence[Channel], start_ns: int | None, end_ns: int | None
    ) -> Iterator[StoredMessage]:
        """Yield the messages of all files in the order of log time; count them if all are asked for."""
        self._check_open()
        parts = [file.messages(channels, start_ns, end_ns) for file in self._files]
        merged = parts[0] if len(parts) == 1 else heapq.merge(*parts, key=_log_time)
        read = 0
        for stored in merged:
            yield self._decompressed(stored) if self._compressed else stored
            self._check_open()
            read += 1
        expected = sum(channel.count for channel in channels)
        if start_ns is None and end_ns is None and read != expected:
            said = f"the index names {expected} messages, {read} were read"
            self._warn(f"log {self.path}: {said}")

    def _warn(self, warning: str) -> None:
        self.warnings.append(warning)
        _LOG.warning(warning)

    def _decompressed(self, stored: StoredMessage) -> StoredMessage:
        try:
            return stored._replace(data=decompress(stored.data))
        except ZstdError as error:
            raise LogError(f"log {self.path}: damaged: {error}") from error

    def _decoder(self, channel: Channel) -> Callable[[bytes], Any]:
        if channel not in self._decoders:
            self._decoders[channel] = self._new_decoder(channel)
        return self._decoders[channel]

    def _new_decoder(self, channel: Channel) -> Callable[[bytes], Any]:
        name = channel.type_name
        if channel.encoding == "cdr":
            text = self._text_of(channel) if channel.definition_encoding == "ros2msg" else ""
            if text and not is_known_as(name, text):
                return decoder_from_definition(name, text)
            if is_known(name):
                return decoder(name)
        said = f"given messages {channel.encoding!r}, definition {channel.definition_encoding!r}"
        allowed = "allowed are 'cdr' and 'ros2msg', or types known here and by --interfaces"
        raise LogError(f"log {self.path}: topic {channel.topic}: {said}; {allowed}")

    def _text_of(self, channel: Channel) -> str:
        try:
            return channel.definition.decode()
        except UnicodeDecodeError as exc:
            raise LogError(
                f"log {self.path}: the definition of {channel.type_name} is no UTF-8: {exc}"
            ) from exc


_log_time = attrgetter("log_time_ns")


def _missing(kind: str, name: str, present: Iterable[str]) -> LogError:
    return LogError(f"log: no {kind} {name!r}; there is {', '.join(present) or 'none at all'}")
