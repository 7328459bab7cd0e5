"""Reading one MCAP file, also one without an index or one whose writer was killed.

The reader believes no length: it checks a record against the size of the file before it reads the
record, and a chunk against its compressed size before it decompresses the chunk.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field
from heapq import heappop, heappush
from io import SEEK_END, BytesIO
from operator import attrgetter
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from lz4.frame import LZ4FrameDecompressor
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from zstandard import ZstdError

from sfglab.record.parts import Channel, LogError, StoredMessage
from sfglab.record.zstd import decompress, most_bytes

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # opcode, length
_FOOTER = struct.Struct("<BQQQI")  # head, start of the summary and of its offsets, CRC
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_RECORDS: dict[int, Any] = {
    Opcode.ATTACHMENT: records.Attachment,
    Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
    Opcode.CHANNEL: records.Channel,
    Opcode.CHUNK: records.Chunk,
    Opcode.CHUNK_INDEX: records.ChunkIndex,
    Opcode.DATA_END: records.DataEnd,
    Opcode.METADATA: records.Metadata,
    Opcode.METADATA_INDEX: records.MetadataIndex,
    Opcode.SCHEMA: records.Schema,
    Opcode.STATISTICS: records.Statistics,
}
# Checksums and text that are wrong are ValueErrors, lz4's error is a RuntimeError, and mcap
# believes lengths and offsets before it uses them.
_DAMAGE = (
    McapError,
    ZstdError,
    ValueError,
    KeyError,
    struct.error,
    OSError,
    OverflowError,
    MemoryError,
    RuntimeError,
    EOFError,
)
# A chunk may hold so many records, and 2 more for each compressed byte: their times differ.
_MOST_RECORDS = 256
# Kinds of records that stand in the data section alone, and in the summary section alone.
_DATA = (records.Attachment, records.Chunk, records.Message, records.Metadata)
_SUMMARY = (
    records.AttachmentIndex,
    records.ChunkIndex,
    records.MetadataIndex,
    records.Statistics,
)


class _Block(NamedTuple):
    """A chunk, or a message outside chunks."""

    offset: int
    start_ns: int
    end_ns: int
    channels: frozenset[int] | None  # None: not known before it is read


@dataclass(slots=True)
class _Index:
    """Contents of a file, from its summary section or from a scan."""

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    blocks: dict[int, _Block] = field(default_factory=dict)  # by offset
    metadata: dict[int, None] = field(default_factory=dict)  # offsets
    attachments: dict[str, tuple[int, str]] = field(default_factory=dict)  # offset, media type
    span_ns: tuple[int, int] | None = None  # as the summary says
    is_whole: bool = False

    @property
    def is_complete(self) -> bool:
        """Whether each message can be found, with its channel and schema."""
        known = self.counts.keys() <= self.channels.keys()
        schemas = {channel.schema_id for channel in self.channels.values()}
        # An empty map of counts says that they are not known.
        return known and schemas <= {0, *self.schemas} and bool(self.blocks) == bool(self.counts)

    def add(self, record: Any, offset: int) -> None:
        """Add a record of the data section or of a chunk."""
        if isinstance(record, records.Schema):
            self.schemas[record.id] = record
        elif isinstance(record, records.Channel):
            self.channels[record.id] = record
        elif isinstance(record, records.Metadata):
            self.metadata[offset] = None
        elif isinstance(record, records.Attachment):
            self.attachments[record.name] = offset, record.media_type
        elif isinstance(record, records.Chunk):
            self._add_messages(_records_of_chunk(record), offset)
        elif isinstance(record, records.Message):
            self._add_messages([record], offset)
        elif isinstance(record, records.DataEnd):
            self.is_whole = True
        else:
            self._add_summary(record)

    def _add_summary(self, record: Any) -> None:
        if isinstance(record, records.MetadataIndex):
            self.metadata[record.offset] = None
        elif isinstance(record, records.AttachmentIndex):
            self.attachments[record.name] = record.offset, record.media_type
        elif isinstance(record, records.Statistics):
            self.counts = Counter(record.channel_message_counts)
            if record.message_count:  # a chunk without messages has zeros for its times
                self.span_ns = record.message_start_time, record.message_end_time
            self.is_whole = True
        else:
            times = record.message_start_time, record.message_end_time
            channels = frozenset(record.message_index_offsets) or None
            start = record.chunk_start_offset
            self.blocks[start] = _Block(start, *times, channels)

    def _add_messages(self, found: list[Any], offset: int) -> None:
        """Add definitions and messages of a block; no message where one has no channel."""
        messages = [record for record in found if isinstance(record, records.Message)]
        for record in found:
            if not isinstance(record, records.Message):
                self.add(record, offset)
        counts = Counter(message.channel_id for message in messages)
        if not counts.keys() <= self.channels.keys():
            raise McapError("a message has a channel that was never written")
        if messages:
            times = [message.log_time for message in messages]
            self.counts.update(counts)
            self.blocks[offset] = _Block(offset, min(times), max(times), frozenset(counts))


class McapFile:
    """One MCAP file; see `sfglab.record.parts.LogFile`."""

    def __init__(self, path: Path, name: Path) -> None:
        """Open a file, which errors call `name`, and read its index, or make one where it has none.

        Raises:
            LogError: The file cannot be opened, is empty or is no MCAP file.
        """
        self._path = name
        try:
            self._stream = path.open("rb")
        except OSError as error:
            raise LogError(f"log {name}: cannot be read: {error.strerror}") from error
        try:
            self._size = self._stream.seek(0, SEEK_END)
            self._index = self._read_index()
        except BaseException:
            self._stream.close()
            raise
        self._channels = {
            number: self._channel(number, record) for number, record in self._index.channels.items()
        }
        self.channels = tuple(self._channels.values())
        self.truncated = not self._index.is_whole
        self.span_ns = self._index.span_ns
        blocks = self._index.blocks.values()
        if blocks and self.span_ns is None:
            self.span_ns = min(b.start_ns for b in blocks), max(b.end_ns for b in blocks)

    def _channel(self, number: int, record: records.Channel) -> Channel:
        schema = self._index.schemas.get(record.schema_id)
        return Channel(
            topic=record.topic,
            type_name=schema.name if schema else "",
            encoding=record.message_encoding,
            definition=schema.data if schema else b"",
            definition_encoding=schema.encoding if schema else "",
            offered_qos=record.metadata.get("offered_qos_profiles", ""),
            count=self._index.counts[number],
        )

    def messages(
        self, channels: Collection[Channel], start_ns: int | None, end_ns: int | None
    ) -> Iterator[StoredMessage]:
        """Yield messages in the order of log time; blocks are read one after the other."""
        asked = frozenset(channels)
        wanted = {number for number, channel in self._channels.items() if channel in asked}
        after = 2**64 if end_ns is None else end_ns
        blocks = [
            block
            for block in self._index.blocks.values()
            if (block.channels is None or block.channels & wanted)
            and block.end_ns >= (start_ns or 0)
            and block.start_ns < after
        ]
        blocks.sort(key=attrgetter("start_ns", "offset"))
        # Messages of one time come in the order of the file: by block, then within the block.
        pending: list[tuple[int, int, int, StoredMessage]] = []
        for block in blocks:
            while pending and pending[0][0] < block.start_ns:
                yield heappop(pending)[-1]
            for number, stored in enumerate(self._stored(block, wanted)):
                if (start_ns or 0) <= stored.log_time_ns < after:
                    heappush(pending, (stored.log_time_ns, block.offset, number, stored))
        while pending:
            yield heappop(pending)[-1]

    def _stored(self, block: _Block, wanted: set[int]) -> list[StoredMessage]:
        found = []
        with self._damage():
            record = self._record(block.offset, (records.Chunk, records.Message))
            is_chunk = isinstance(record, records.Chunk)
            for message in _records_of_chunk(record) if is_chunk else [record]:
                if isinstance(message, records.Message):
                    channel = self._channels[message.channel_id]
                    if message.channel_id in wanted:
                        times = message.log_time, message.publish_time
                        found.append(StoredMessage(channel, *times, message.data))
        return found

    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Return the metadata records by name; of several with one name, the last."""
        with self._damage():
            found = [self._record(offset, records.Metadata) for offset in self._index.metadata]
        return {record.name: record.metadata for record in found}

    def media_types(self) -> Mapping[str, str]:
        """Return the names of the attached files with their media types."""
        return {name: kind for name, (_, kind) in self._index.attachments.items()}

    def attachment(self, name: str) -> bytes:
        """Return the content of one attached file."""
        offset, _ = self._index.attachments[name]
        with self._damage():
            return bytes(self._record(offset, records.Attachment).data)

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        self._stream.close()

    @contextmanager
    def _damage(self) -> Iterator[None]:
        try:
            yield
        except _DAMAGE as error:
            raise LogError(f"log {self._path}: damaged: {error}") from error

    def _record(self, offset: int, kinds: Any) -> Any:
        found = next(_records_from(self._stream, self._size, offset), None)
        if found is None or not isinstance(found[0], kinds):
            raise McapError(f"the record at {offset} is not what the index says")
        return found[0]

    def _read_index(self) -> _Index:
        if self._size == 0:
            raise LogError(f"log {self._path}: the file is empty")
        self._stream.seek(0)
        if self._stream.read(len(_MAGIC)) != _MAGIC:
            said = "not an MCAP file, nor a bag (a folder or a .db3 file)"
            raise LogError(f"log {self._path}: {said}")
        index = _Index()
        start = self._summary_start()
        if start:
            self._add_from(index, start)
        if not start or not index.is_whole or not index.is_complete:
            index = _Index()
            self._add_from(index, len(_MAGIC))
        return index

    def _add_from(self, index: _Index, start: int) -> None:
        """Add whole records up to the end of a section; one that is cut off or damaged ends it."""
        others = _SUMMARY if start == len(_MAGIC) else _DATA
        try:
            for record, offset in _records_from(self._stream, self._size, start):
                if record is None or isinstance(record, others):
                    continue
                index.add(record, offset)
                if isinstance(record, records.DataEnd):
                    return
        except _DAMAGE:
            return

    def _summary_start(self) -> int:
        """Return where a sound summary section begins; 0 where the file has none."""
        footer_start = self._size - _FOOTER.size - len(_MAGIC)
        if footer_start < len(_MAGIC):
            return 0
        self._stream.seek(footer_start)
        footer = self._stream.read(_FOOTER.size)
        opcode, _, start, _, crc = _FOOTER.unpack(footer)
        ends_well = self._stream.read() == _MAGIC and opcode == Opcode.FOOTER
        if not ends_well or not 0 < start <= footer_start:
            return 0
        self._stream.seek(start)
        summary = self._stream.read(footer_start - start)
        is_sound = crc in {0, zlib.crc32(footer[:-4], zlib.crc32(summary))}
        return int(start) if is_sound else 0


def _records_from(stream: BinaryIO, size: int, offset: int = 0) -> Iterator[tuple[Any, int]]:
    """Yield each whole record with its offset; None for a record of an unknown kind."""
    while 0 <= offset <= size - _HEAD.size:
        stream.seek(offset)
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        end = offset + _HEAD.size + length
        if opcode == 0 or end > size:
            return
        if opcode == Opcode.MESSAGE:
            content = stream.read(length)
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(content)
            data = content[_MESSAGE.size :]
            message = records.Message(channel, log_ns, data, publish_ns, sequence)
            yield message, offset
        elif opcode in _RECORDS:
            content_stream = ReadDataStream(BytesIO(stream.read(length)))
            yield _RECORDS[opcode].read(content_stream), offset
        else:
            yield None, offset
        offset = end
        stream.seek(end)


def _records_of_chunk(chunk: records.Chunk) -> list[Any]:
    """Return the schemas, channels and messages of a chunk.

    Raises:
        McapError: It holds another record, or more than real ones do.
    """
    content = _decompressed(chunk)
    most = _MOST_RECORDS + 2 * len(chunk.data)
    found: list[Any] = []
    stream = BytesIO(content)
    for number, (record, _) in enumerate(_records_from(stream, len(content))):
        if number >= most:
            raise McapError(f"a chunk holds more than {most} records")
        if record is None:
            continue
        if not isinstance(record, (records.Schema, records.Channel, records.Message)):
            raise McapError(f"a chunk holds a record of kind {type(record).__name__}")
        found.append(record)
    if stream.tell() != len(content):
        raise McapError("a chunk ends within a record")
    return found


def _decompressed(chunk: records.Chunk) -> bytes:
    """Return the records of a chunk, decompressed as far as the chunk says."""
    data, size = chunk.data, chunk.uncompressed_size
    most = most_bytes(len(data))
    if size > most:
        raise McapError(f"a chunk of {len(data)} bytes claims {size}; allowed are {most}")
    if chunk.compression == "zstd":
        data = decompress(data, size)
    elif chunk.compression == "lz4":
        lz4 = LZ4FrameDecompressor()
        data = lz4.decompress(data, max_length=size)
        if not lz4.eof:
            raise McapError(f"a chunk claims {size} bytes and holds more")
    elif chunk.compression:
        raise McapError(f"a chunk is compressed by {chunk.compression!r}; allowed are zstd and lz4")
    if len(data) != size:
        raise McapError(f"a chunk claims {size} bytes and holds {len(data)}")
    if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise McapError("the checksum of a chunk does not match its content")
    return data
