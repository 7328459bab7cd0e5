"""Finding what is whole in an MCAP file that has no index, because its writer was killed or never wrote one.

Knows how records follow each other (MCAP specification, "Records"). Refuses to guess: the first record that is
cut off or damaged ends the file.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from io import BytesIO
from typing import TYPE_CHECKING, Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from zstandard import ZstdError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
# What the library raises for bytes that are not what they should be: CRC errors and bad text are ValueErrors,
# and lengths and offsets are believed before they are tried.
DAMAGE = (McapError, ZstdError, ValueError, KeyError, struct.error, OSError, OverflowError, MemoryError)


class UnchunkedError(Exception):
    """Messages lie outside chunks, where nothing but an index finds them in order."""


@dataclass(kw_only=True)
class Scan:
    """What was found so far."""

    summary: Summary = field(default_factory=Summary)  #: The index that the file lacks.
    complete: bool = False  #: Whether the data section ends as it should.


def has_sound_index(stream: BinaryIO, size: int) -> bool:
    """Return whether a file of so many bytes ends with an index that can be trusted; not if it was cut off.

    The library does not check its CRC.
    """
    footer_start = size - _FOOTER.size - len(MAGIC)
    if footer_start < len(MAGIC):
        return False
    stream.seek(footer_start)
    footer = stream.read(_FOOTER.size)
    opcode, _, summary_start, _, crc = _FOOTER.unpack(footer)
    if stream.read() != MAGIC or opcode != Opcode.FOOTER or not 0 < summary_start <= footer_start:
        return False
    stream.seek(summary_start)
    summary = stream.read(footer_start - summary_start)
    return crc in {0, zlib.crc32(footer[:-4], zlib.crc32(summary))}


def _whole_records(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield offset, opcode and content of each record that is there to its end."""
    offset = len(MAGIC)
    while offset + _RECORD_HEAD.size <= size:
        stream.seek(offset)
        opcode, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
        end = offset + _RECORD_HEAD.size + length
        if opcode == 0 or end > size:
            return
        yield offset, opcode, stream.read(length)
        offset = end


def _add_definition(summary: Summary, record: Any) -> None:
    if isinstance(record, Schema):
        summary.schemas[record.id] = record
    elif isinstance(record, Channel):
        summary.channels[record.id] = record


def _add_chunk(summary: Summary, offset: int, content: bytes) -> None:
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    records = breakup_chunk(chunk, validate_crc=True)
    for record in records:
        _add_definition(summary, record)
    channels = Counter(record.channel_id for record in records if isinstance(record, Message))
    if not channels.keys() <= summary.channels.keys():
        raise McapError("a message of a channel that was never written")
    assert summary.statistics is not None
    for channel, count in channels.items():
        summary.statistics.channel_message_counts[channel] += count
    summary.chunk_indexes.append(
        ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=offset,
            chunk_length=_RECORD_HEAD.size + len(content),
            message_index_offsets={},
            message_index_length=0,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
    )


def _add_metadata(summary: Summary, offset: int, content: bytes) -> None:
    name = Metadata.read(ReadDataStream(BytesIO(content))).name
    summary.metadata_indexes.append(MetadataIndex(offset=offset, length=len(content), name=name))


def _add_attachment(summary: Summary, offset: int, content: bytes) -> None:
    found = Attachment.read(ReadDataStream(BytesIO(content)))
    summary.attachment_indexes.append(
        AttachmentIndex(
            offset=offset,
            length=len(content),
            log_time=found.log_time,
            create_time=found.create_time,
            data_size=len(found.data),
            name=found.name,
            media_type=found.media_type,
        )
    )


_INDEXERS: dict[int, Callable[[Summary, int, bytes], None]] = {
    Opcode.SCHEMA: lambda s, _, b: _add_definition(s, Schema.read(ReadDataStream(BytesIO(b)))),
    Opcode.CHANNEL: lambda s, _, b: _add_definition(s, Channel.read(ReadDataStream(BytesIO(b)))),
    Opcode.CHUNK: _add_chunk,
    Opcode.METADATA: _add_metadata,
    Opcode.ATTACHMENT: _add_attachment,
}


def scan(stream: BinaryIO, size: int) -> Scan:
    """Read a file of so many bytes from its start; return an index of what is whole, with counts per channel.

    Raises:
        UnchunkedError: Messages lie outside chunks.
    """
    found = Scan()
    found.summary.statistics = Statistics(
        attachment_count=0,
        channel_count=0,
        channel_message_counts=defaultdict(int),
        chunk_count=0,
        message_count=0,
        message_end_time=0,
        message_start_time=0,
        metadata_count=0,
        schema_count=0,
    )
    for offset, opcode, content in _whole_records(stream, size):
        if opcode == Opcode.MESSAGE:
            raise UnchunkedError
        if opcode == Opcode.DATA_END:
            found.complete = True
            break
        if opcode in _INDEXERS:
            try:
                _INDEXERS[opcode](found.summary, offset, content)
            except DAMAGE:
                break
    return found
