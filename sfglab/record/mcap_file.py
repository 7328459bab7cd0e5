"""Reading one MCAP file, also one without an index or one whose writer was killed.

The library `mcap` reads the fields of a record. It believes lengths and sizes and refuses a file that
was cut off, so this module finds the records, decompresses chunks and makes a missing index.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field
from heapq import heappop, heappush
from io import SEEK_END, BytesIO
from itertools import islice
from operator import attrgetter
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from lz4.frame import LZ4FrameDecompressor
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from sfglab.record.parts import (
    DAMAGE,
    MSG,
    QOS_KEY,
    Channel,
    LogError,
    LogMessage,
    damage_named,
    decompress,
    most_bytes,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from contextlib import ExitStack
    from pathlib import Path

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")  # opcode, length
_FOOTER = struct.Struct("<BQQQI8s")  # head, start of the summary and of its offsets, CRC, magic
_CHECKED = _FOOTER.size - len(_MAGIC) - 4  # bytes before the CRC
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_NO_SCHEMA = records.Schema(id=0, data=b"", encoding="", name="")
# A chunk may hold so many records, and 2 more for each compressed byte: their times differ.
_MOST_RECORDS = 256


class _Record(NamedTuple):
    """A record that is not read yet."""

    offset: int
    opcode: int
    content: bytes

    @property
    def stream(self) -> ReadDataStream:
        """The content as the library reads it."""
        return ReadDataStream(BytesIO(self.content))


class _Block(NamedTuple):
    """A chunk, or a message outside chunks."""

    offset: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]  # empty: not known before it is read


@dataclass(slots=True)
class _Index:
    """Contents of a file, from its summary section or from a scan."""

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    blocks: list[_Block] = field(default_factory=list)
    metadata: dict[str, int] = field(default_factory=dict)  # offsets by name
    attachments: dict[str, int] = field(default_factory=dict)  # offsets by name
    is_whole: bool = False

    @property
    def is_complete(self) -> bool:
        """Whether each message can be found, with its channel and schema."""
        schemas = {channel.schema_id for channel in self.channels.values()}
        is_defined = self.counts.keys() <= self.channels.keys() and schemas <= {0, *self.schemas}
        # An empty map of counts says that they are not known.
        return self.is_whole and is_defined and bool(self.blocks) == bool(self.counts)

    def add_section(self, stream: BinaryIO, size: int, start: int) -> None:
        """Add whole records up to the end of a section; one that is cut off or damaged ends it."""
        try:
            for record in _records_from(stream, size, start):
                if record.opcode == Opcode.DATA_END:
                    self.is_whole = True
                    return
                self._add(record)
        except DAMAGE:
            return

    def _add(self, record: _Record) -> None:
        stream = record.stream
        match record.opcode:
            case Opcode.SCHEMA:
                schema = records.Schema.read(stream)
                self.schemas[schema.id] = schema
            case Opcode.CHANNEL:
                channel = records.Channel.read(stream)
                self.channels[channel.id] = channel
            case Opcode.CHUNK | Opcode.MESSAGE:
                self._add_block(record)
            case Opcode.CHUNK_INDEX:
                chunk = records.ChunkIndex.read(stream)
                times = chunk.message_start_time, chunk.message_end_time
                channels = frozenset(chunk.message_index_offsets)
                self.blocks.append(_Block(chunk.chunk_start_offset, *times, channels))
            case Opcode.METADATA:
                self.metadata[records.Metadata.read(stream).name] = record.offset
            case Opcode.METADATA_INDEX:
                metadata = records.MetadataIndex.read(stream)
                self.metadata[metadata.name] = metadata.offset
            case Opcode.ATTACHMENT:
                self.attachments[records.Attachment.read(stream).name] = record.offset
            case Opcode.ATTACHMENT_INDEX:
                attachment = records.AttachmentIndex.read(stream)
                self.attachments[attachment.name] = attachment.offset
            case Opcode.STATISTICS:
                self.counts = Counter(records.Statistics.read(stream).channel_message_counts)
                self.is_whole = True

    def _add_block(self, block: _Record) -> None:
        """Add a scanned block: its definitions, and times and counts of its messages."""
        times = []
        counts: Counter[int] = Counter()
        for record in _records_of_block(block):
            if record.opcode == Opcode.MESSAGE:
                channel, _, log_time_ns, _ = _MESSAGE.unpack_from(record.content)
                times.append(log_time_ns)
                counts[channel] += 1
            elif record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                self._add(record)
        if not counts.keys() <= self.channels.keys():
            raise McapError("a message has a channel that was never written")
        if times:
            self.counts.update(counts)
            self.blocks.append(_Block(block.offset, min(times), max(times), frozenset(counts)))


class McapFile:
    """One open MCAP file of a log, with its index."""

    def __init__(self, path: Path, name: Path, stack: ExitStack) -> None:
        """Open a file, which errors call `name`, and read its index, or make one where it has none.

        `stack` closes the file.

        Raises:
            LogError: The file cannot be opened, or is no MCAP file.
        """
        self.path = name
        with damage_named(name):
            self._stream = stack.enter_context(path.open("rb"))
            self._size = self._stream.seek(0, SEEK_END)
        index = self._read_index()
        #: The channels by their numbers.
        self.channels = {
            number: _channel(
                record, index.schemas.get(record.schema_id, _NO_SCHEMA), index.counts[number]
            )
            for number, record in index.channels.items()
        }
        self.truncated = not index.is_whole  #: Whether the file ends before its data does.
        self.metadata = index.metadata  #: Offsets of the metadata records, by name.
        self.attachments = index.attachments  #: Offsets of the attached files, by name.
        self._index = index

    @property
    def times_ns(self) -> list[int]:
        """Log times, ns; those of the first and the last message are among them."""
        times_ns = []
        for block in self._index.blocks:
            # A chunk without messages has zeros for its times.
            if block.channels or block.end_ns:
                times_ns += [block.start_ns, block.end_ns]
        return times_ns

    def messages(
        self, channels: Collection[Channel], start_ns: int, end_ns: int
    ) -> Iterator[LogMessage]:
        """Yield messages in the order of log time; blocks are read one after the other."""
        wanted = {number for number, channel in self.channels.items() if channel in channels}
        # Messages of one time come in the order of the file: by block, then within the block.
        pending: list[tuple[int, int, int, LogMessage]] = []
        for block in sorted(self._index.blocks, key=attrgetter("start_ns")):
            is_elsewhere = block.channels and block.channels.isdisjoint(wanted)
            if is_elsewhere or block.end_ns < start_ns or block.start_ns >= end_ns:
                continue
            while pending and pending[0][0] < block.start_ns:
                yield heappop(pending)[-1]
            for number, message in enumerate(self._stored(block, wanted)):
                time_ns = message.log_time_ns
                if start_ns <= time_ns < end_ns:
                    heappush(pending, (time_ns, block.offset, number, message))
        while pending:
            yield heappop(pending)[-1]

    def _stored(self, block: _Block, wanted: set[int]) -> list[LogMessage]:
        stored = []
        with damage_named(self.path):
            for record in _records_of_block(self._record(block.offset)):
                if record.opcode != Opcode.MESSAGE:
                    continue
                number, _, log_ns, publish_ns = _MESSAGE.unpack_from(record.content)
                if number in wanted:
                    cdr = record.content[_MESSAGE.size :]
                    stored.append(LogMessage(self.channels[number], log_ns, publish_ns, cdr))
        return stored

    def strings(self, name: str) -> dict[str, str]:
        """Return the entries of the metadata record with a name.

        Raises:
            LogError: The record is damaged.
        """
        with damage_named(self.path):
            record = self._record(self.metadata[name])
            return dict(records.Metadata.read(record.stream).metadata)

    def attachment(self, name: str) -> bytes:
        """Return the bytes of the attachment with a name.

        Raises:
            LogError: The record is damaged.
        """
        with damage_named(self.path):
            record = self._record(self.attachments[name])
            return bytes(records.Attachment.read(record.stream).data)

    def _record(self, offset: int) -> _Record:
        for record in _records_from(self._stream, self._size, offset):
            return record
        raise McapError(f"there is no record at {offset}")

    def _read_index(self) -> _Index:
        self._stream.seek(0)
        if self._stream.read(len(_MAGIC)) != _MAGIC:
            said = "this is no log; give an MCAP file, a bag's folder or its .db3 file"
            raise LogError(f"log {self.path}: {said}")
        index = _Index()
        index.add_section(self._stream, self._size, self._summary_start())
        if not index.is_complete:
            index = _Index()
            index.add_section(self._stream, self._size, len(_MAGIC))
        return index

    def _summary_start(self) -> int:
        """Return the offset of the summary section; the end of the file where it has none or a damaged one."""
        footer_start = self._size - _FOOTER.size
        if footer_start >= 0:
            self._stream.seek(footer_start)
            footer = self._stream.read()
            opcode, _, start, _, crc, magic = _FOOTER.unpack(footer)
            if (opcode, magic) == (Opcode.FOOTER, _MAGIC) and 0 < start <= footer_start:
                self._stream.seek(start)
                checked = self._stream.read(footer_start - start) + footer[:_CHECKED]
                if crc in {0, zlib.crc32(checked)}:  # 0: not known
                    return int(start)
        return self._size


def _channel(record: records.Channel, schema: records.Schema, count: int) -> Channel:
    return Channel(
        topic=record.topic,
        type_name=schema.name,
        encoding=record.message_encoding,
        definition=schema.data.decode(errors="replace") if schema.encoding == MSG else "",
        definition_encoding=schema.encoding,
        offered_qos=record.metadata.get(QOS_KEY, ""),
        count=count,
    )


def _records_from(stream: BinaryIO, size: int, start: int) -> Iterator[_Record]:
    """Yield each whole record."""
    stream.seek(start)
    offset = start
    while offset + _HEAD.size <= size:
        opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
        end = offset + _HEAD.size + length
        if opcode == 0 or end > size:
            return
        yield _Record(offset, opcode, stream.read(length))
        offset = end


def _records_of_block(record: _Record) -> list[_Record]:
    """Return a message's record, or the records in a chunk.

    Raises:
        McapError: There are more than in real chunks, or one is cut off.
    """
    if record.opcode == Opcode.MESSAGE:
        return [record]
    chunk = records.Chunk.read(record.stream)
    content = _decompressed(chunk)
    stream = BytesIO(content)
    most = _MOST_RECORDS + 2 * len(chunk.data)
    found = list(islice(_records_from(stream, len(content), 0), most))
    if stream.tell() != len(content):
        raise McapError(f"a chunk ends within a record, or holds more than {most} records")
    return found


def _decompressed(chunk: records.Chunk) -> bytes:
    """Return the records of a chunk, decompressed as far as the chunk says and real ones go."""
    data = chunk.data
    size = min(chunk.uncompressed_size, most_bytes(len(data)))
    if chunk.compression == "zstd":
        data = decompress(data, size)
    elif chunk.compression == "lz4":
        # Without a largest length, lz4 allocates what the frame's header says.
        data = LZ4FrameDecompressor().decompress(data, max_length=size)
    elif chunk.compression:
        raise McapError(f"a chunk is compressed by {chunk.compression!r}; allowed: zstd and lz4")
    if len(data) != chunk.uncompressed_size:
        raise McapError(f"a chunk claims {chunk.uncompressed_size} bytes; {len(data)} were read")
    if chunk.uncompressed_crc not in {0, zlib.crc32(data)}:
        raise McapError("the checksum of a chunk does not match its content")
    return data
