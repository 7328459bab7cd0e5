"""Reading a log: messages, tables, metadata; also of other recorders, and also when it was cut off.

Knows MCAP with ROS 2 messages; `bags` makes bags such. Refuses to know what the messages mean.
"""

from __future__ import annotations

import difflib
import itertools
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from io import SEEK_END
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from sfglab.messages import decoder, decoder_from_definition
from sfglab.messages.store import is_known_as
from sfglab.record.looking import ShownMessage, number_in
from sfglab.record.metadata import QOS_KEY, LogError, profile_from_bag, values_from_strings
from sfglab.record.writer import TABLE_PREFIX, TIME_COLUMN
from sfglab.tables import html_table
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import pandas as pd
    from mcap.reader import SeekingReader
    from mcap.records import Channel, Schema
    from mcap.summary import Summary

    from sfglab.qos import QoSProfile
    from sfglab.record.bags import Bag


def is_bag(path: Path) -> bool:
    """Return whether a path looks like a bag's: a folder, .db3 or .bag."""
    return path.is_dir() or path.suffix in {".db3", ".bag"}


def is_log(path: Path) -> bool:
    """Return whether a path looks like what `LogReader` opens: an MCAP file or a bag."""
    return path.suffix == ".mcap" or is_bag(path)


_SAMPLE = 200
"""Messages of a topic that its rate and size are taken from, so that a long log is listed at once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """What a log has of one topic."""

    type_name: str  #: ROS type of its messages.
    count: int  #: How many.


class LogMessage(NamedTuple):
    """One message as it was recorded."""

    topic: str  #: Its topic.
    type_name: str  #: Its ROS type.
    log_time_ns: int  #: When it was received, on the run's clock.
    publish_time_ns: int  #: When it was published, on the same clock.
    cdr: bytes  #: Its bytes.


class DecodedMessage(NamedTuple):
    """One message, deserialised; fields as of `LogMessage`."""

    topic: str
    type_name: str
    log_time_ns: int
    publish_time_ns: int
    message: Any  #: Arrays are read-only.


def rate_and_size(messages: Sequence[LogMessage]) -> tuple[float, float]:
    """Return rate [Hz] and mean size [bytes] of a topic's messages; 0 where there are too few."""
    span_s = (messages[-1].log_time_ns - messages[0].log_time_ns) / NS_PER_S if messages else 0
    size = sum(len(message.cdr) for message in messages) / max(1, len(messages))
    return (len(messages) - 1) / span_s if span_s > 0 else 0.0, size


class LogReader(AbstractContextManager["LogReader"]):
    """An MCAP file or a bag to read, as a context manager; for one thread.

    A bag is a rosbag2 folder (SQLite or MCAP) or its .db3 file, of any ROS 2, or a .bag of ROS 1.

    A file that its writer did not finish, even one that is still being written, is read up to its last whole
    chunk at the time of opening; `truncated` says so.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open a file of any recorder and read its index.

        Raises LogError where there is no file, or it is neither an MCAP file nor a bag, or has neither chunks
        nor an index.
        """
        self.path = Path(path)  #: The file.
        self.truncated = False  #: Whether the file ends before its data does.
        self._decoders: dict[int, Callable[[bytes], Any]] = {}
        self._stream: BinaryIO | Bag
        self._mcap: Any
        if is_bag(self.path):
            from sfglab.record.bags import Bag

            self._mcap = self._stream = Bag(self.path)
            self._summary = self._mcap.summary
            return
        try:
            self._stream = stream = self.path.open("rb")
        except FileNotFoundError as exc:
            raise LogError(f"log {self.path}: no such file") from exc
        try:
            self._mcap, self._summary = self._indexed(stream)
        except BaseException:
            stream.close()
            raise

    def _indexed(self, stream: BinaryIO) -> tuple[SeekingReader, Summary]:
        """Return a reader with the file's own index, or with one from a scan."""
        from sfglab.record.recovery import (
            DAMAGE,
            MAGIC,
            SeekingReader,
            UnchunkedError,
            has_sound_index,
            scan,
        )

        size = stream.seek(0, SEEK_END)
        stream.seek(0)
        if size == 0:
            raise LogError(f"log {self.path}: the file is empty")
        if stream.read(len(MAGIC)) != MAGIC:
            raise LogError(f"log {self.path}: not an MCAP file, nor a bag (a folder, .db3 or .bag)")
        stream.seek(0)
        reader = SeekingReader(stream, validate_crcs=True, record_size_limit=size)
        own = None
        if has_sound_index(stream, size):
            with suppress(*DAMAGE):  # then a scan finds out
                own = reader.get_summary()
        if own is not None and own.statistics is not None:
            return reader, own
        try:
            summary, whole = scan(stream, size)
        except UnchunkedError as exc:
            said = "no index, and messages outside chunks: try `mcap recover`"
            raise LogError(f"log {self.path}: {said}") from exc
        self.truncated = not whole
        stream.seek(0)
        return _scanned_reader(stream, summary), summary

    @property
    def topics(self) -> dict[str, TopicInfo]:
        """The topics in this log, sorted by name; tables are among them."""
        counts: dict[str, TopicInfo] = {}
        statistics = self._summary.statistics
        assert statistics is not None
        for channel in sorted(self._summary.channels.values(), key=lambda c: c.topic):
            before = counts[channel.topic].count if channel.topic in counts else 0
            count = before + statistics.channel_message_counts.get(channel.id, 0)
            counts[channel.topic] = TopicInfo(type_name=self._type_of(channel), count=count)
        return counts

    @property
    def span_ns(self) -> tuple[int, int]:
        """When the first and the last message were received, log times in nanoseconds; zeros without any."""
        statistics = self._summary.statistics
        assert statistics is not None
        span_ns = statistics.message_start_time, statistics.message_end_time
        return span_ns if statistics.message_count else (0, 0)

    def offered_qos(self, topic: str) -> QoSProfile:
        """Return what a topic's writers offered, as the log has it, in ROS 2's default profile's place."""
        texts = (
            c.metadata.get(QOS_KEY, "") for c in self._summary.channels.values() if c.topic == topic
        )
        return profile_from_bag("\n".join(filter(None, texts)))

    def definition(self, topic: str) -> str:
        """Return the definition of a topic's type that the log has; empty where it has none as `.msg`."""
        found = (
            schema for schema in self._schemas_of(topic) if schema and schema.encoding == "ros2msg"
        )
        return next(map(self._text_of, found), "")

    @property
    def media_types(self) -> dict[str, str]:
        """The attached files in this log with their media types, in the order of writing."""
        return {index.name: index.media_type for index in self._summary.attachment_indexes}

    def __repr__(self) -> str:
        cut = ", cut off" if self.truncated else ""
        count = sum(info.count for info in self.topics.values())
        return f"<log {self.path.name}: {count} messages of {len(self.topics)} topics{cut}>"

    def _repr_html_(self) -> str:
        more = (
            f"metadata: {', '.join(self.metadata_names)}",
            f"attached: {', '.join(self.attachment_names)}",
        )
        said = "; ".join((repr(self)[1:-1], *(text for text in more if not text.endswith(": "))))
        return html_table(self.overview(), said)

    def overview(self) -> list[tuple[str, ...]]:
        """Return a head and a line a topic: type, count, and rate and mean size of its first messages."""
        rows: list[tuple[str, ...]] = [("topic", "type", "messages", "Hz", "bytes")]
        for topic, info in self.topics.items():
            rate_hz, size = rate_and_size(self.first(topic))
            shown = f"{rate_hz:.3g}" if rate_hz else "", f"{size:.0f}" if info.count else ""
            rows.append((topic, info.type_name, str(info.count), *shown))
        return rows

    def first(self, topic: str) -> list[LogMessage]:
        """Return a topic's first messages, at most 200: enough for its rate and size."""
        return (
            list(itertools.islice(self.messages(topic), _SAMPLE))
            if self.topics[topic].count
            else []
        )

    def message(self, topic: str, number: int = 0) -> ShownMessage:
        """Return one message of a topic, counted from 0, to look at; LogError where there is none."""
        found = next(itertools.islice(self.decoded(topic), number, None), None)
        if found is None:
            count = self.topics[topic].count
            raise LogError(
                f"log {self.path}: {topic}: given message {number}, allowed: 0 to {count - 1}"
            )
        return ShownMessage(found.topic, found.type_name, found.message)

    def series(self, topic: str, field: str) -> pd.Series:
        """Return one field of a topic's messages over log time, s from the log's beginning, ready to `.plot()`.

        The field is the way to a number, as in ``pose.pose.position.x`` or ``ranges[0]``; LogError where there
        is none, and as of `decoded`.
        """
        import pandas as pd

        statistics = self._summary.statistics
        assert statistics is not None
        times, values = [], []
        for entry in self.decoded(topic):
            times.append((entry.log_time_ns - statistics.message_start_time) * 1e-9)
            values.append(number_in(entry.message, field, f"log {self.path}: {topic}"))
        return pd.Series(values, index=pd.Index(times, name="s"), name=f"{topic}: {field}")

    @property
    def tables(self) -> tuple[str, ...]:
        """The names of the tables in this log, sorted."""
        return tuple(
            t.removeprefix(TABLE_PREFIX) for t in self.topics if t.startswith(TABLE_PREFIX)
        )

    @property
    def metadata_names(self) -> tuple[str, ...]:
        """The names of the metadata records in this log, in the order of writing."""
        return tuple(dict.fromkeys(index.name for index in self._summary.metadata_indexes))

    @property
    def attachment_names(self) -> tuple[str, ...]:
        """The names of the attached files in this log, in the order of writing."""
        return tuple(self.media_types)

    def metadata(self, name: str) -> dict[str, Any]:
        """Return one metadata record as it was written; LogError for none of that name or a damaged one."""
        if name not in self.metadata_names:
            raise _missing("metadata", name, self.metadata_names)
        records = {
            record.name: record.metadata for record in self._checked(self._mcap.iter_metadata())
        }
        return values_from_strings(records[name])

    def attachment(self, name: str) -> bytes:
        """Return the content of one attached file, by its name; LogError as of `metadata`."""
        if name not in self.attachment_names:
            raise _missing("attachment", name, self.attachment_names)
        found = {
            record.name: record.data for record in self._checked(self._mcap.iter_attachments())
        }
        return bytes(found[name])

    def messages(
        self, topic: str | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[LogMessage]:
        """Return the recorded messages in the order of their log times; a chunk is read when its turn comes.

        Only those of a topic, None: of all; from `start_ns` on and before `end_ns`, log times in nanoseconds.
        Raises LogError where there is no such topic, or the end lies before the start, or while iterating: a
        chunk is damaged, or the log was closed.
        """
        found = self._found(topic, start_ns, end_ns)
        return (
            LogMessage(c.topic, self._type_of(c), m.log_time, m.publish_time, m.data)
            for _, c, m in found
        )

    def decoded(
        self, topic: str, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[DecodedMessage]:
        """Return the messages of a topic, deserialised by the definition in the log; arguments of `messages`.

        Types that this process does not know are read as well. Where the definition is the one that sfglab has,
        the messages are of the type that `sfglab.messages.message_type` returns. Raises LogError as `messages`,
        and while iterating where something is no CDR or no text, CdrError where bytes or definition are of no
        use.
        """
        found = self._found(topic, start_ns, end_ns)
        return (
            DecodedMessage(
                c.topic,
                self._type_of(c),
                m.log_time,
                m.publish_time,
                self._decoder(schema, c)(m.data),
            )
            for schema, c, m in found
        )

    def knows(self, topic: str) -> bool:
        """Return whether a topic's messages are of a type that this process has, with the same fields."""
        schemas = self._schemas_of(topic)
        return all(schema and is_known_as(schema.name, self._text_of(schema)) for schema in schemas)

    def table(self, name: str) -> pd.DataFrame:
        """Return a table of `log_time_ns` and fields in the order of log times; LogError as `metadata`."""
        import pandas as pd

        if name not in self.tables:
            raise _missing("table", name, self.tables)
        columns: dict[str, list[Any]] = {}
        for entry in self.decoded(f"{TABLE_PREFIX}{name}"):
            row = {
                field: value
                for field, value in vars(entry.message).items()
                if field != "__msgtype__"
            }
            for column, value in {TIME_COLUMN: entry.log_time_ns, **row}.items():
                columns.setdefault(column, []).append(value)
        return pd.DataFrame(columns)

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        self._stream.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _type_of(self, channel: Channel) -> str:
        schema = self._summary.schemas.get(channel.schema_id)
        return schema.name if schema else ""

    def _schemas_of(self, topic: str) -> list[Schema | None]:
        channels = [
            channel for channel in self._summary.channels.values() if channel.topic == topic
        ]
        return [self._summary.schemas.get(channel.schema_id) for channel in channels]

    def _found(self, topic: str | None, start_ns: int | None, end_ns: int | None) -> Iterator[Any]:
        topics = self.topics
        if topic is not None and topic not in topics:
            near = tuple(difflib.get_close_matches(topic, topics, n=5, cutoff=0)) or tuple(topics)
            raise _missing("topic", topic, near)
        if start_ns is not None and end_ns is not None and end_ns < start_ns:
            raise LogError(
                f"log {self.path}: the end {end_ns} ns lies before the start {start_ns} ns"
            )
        if self.truncated and not self._summary.chunk_indexes:
            return iter(())
        return self._checked(
            self._mcap.iter_messages(topic, starting_at=start_ns, ending_before=end_ns)
        )

    def _checked(self, records: Iterator[Any]) -> Iterator[Any]:
        """Pass records on; what the library raises for damage becomes one error."""
        from sfglab.record.recovery import DAMAGE

        while True:
            if self._stream.closed:
                raise LogError(f"log {self.path}: it is closed")
            try:
                record = next(records, None)
            except DAMAGE as exc:
                raise LogError(f"log {self.path}: damaged: {exc}") from exc
            if record is None:
                return
            yield record

    def _decoder(self, schema: Schema | None, channel: Channel) -> Callable[[bytes], Any]:
        if channel.id not in self._decoders:
            self._decoders[channel.id] = self._new_decoder(schema, channel)
        return self._decoders[channel.id]

    def _new_decoder(self, schema: Schema | None, channel: Channel) -> Callable[[bytes], Any]:
        encodings = channel.message_encoding, schema.encoding if schema else "none"
        if schema is None or encodings != ("cdr", "ros2msg"):
            said = "given messages {!r}, definition {!r}".format(*encodings)
            raise LogError(
                f"log {self.path}: topic {channel.topic}: {said}, allowed are 'cdr', 'ros2msg'"
            )
        text = self._text_of(schema)
        if is_known_as(schema.name, text):
            return decoder(schema.name)
        return decoder_from_definition(schema.name, text)

    def _text_of(self, schema: Schema) -> str:
        try:
            return schema.data.decode()
        except UnicodeDecodeError as exc:
            raise LogError(
                f"log {self.path}: the definition of {schema.name} is no UTF-8: {exc}"
            ) from exc


def _missing(kind: str, name: str, present: Iterable[str]) -> LogError:
    return LogError(f"log: no {kind} {name!r}; there is {', '.join(present) or 'none at all'}")


def _scanned_reader(stream: BinaryIO, summary: Summary) -> SeekingReader:
    from sfglab.record.recovery import SeekingReader

    class ScannedReader(SeekingReader):  # type: ignore[misc]  # the library's, of a copy
        """The library's reader on an index that is not in the file."""

        def get_summary(self) -> Summary:
            return summary

    return ScannedReader(stream, validate_crcs=True)
