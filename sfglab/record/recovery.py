"""Finding what is whole in an MCAP file that has no index, because its writer was killed or never wrote one.

Knows how records follow each other (MCAP specification, "Records"). Refuses to guess: the first record that is
cut off or damaged ends the file. Refuses to believe: what a chunk takes is bounded by its compressed size.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from dataclasses import fields
from importlib.util import find_spec, module_from_spec
from io import BytesIO
from typing import TYPE_CHECKING, Any, BinaryIO

from lz4.frame import LZ4FrameDecompressor
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
from mcap.summary import Summary
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log and publish time
# What the library raises for bytes that are not what they should be: CRC errors and bad text are ValueErrors,
# and lengths and offsets are believed before they are tried.
DAMAGE: tuple[type[Exception], ...] = (
    McapError,
    ZstdError,
    ValueError,
    KeyError,
    struct.error,
    OSError,
)
DAMAGE += (OverflowError, MemoryError, RuntimeError, EOFError)  # lz4's is a RuntimeError

_MOST_BYTES = (
    2**26
)  # of a chunk, beside a thousand for each compressed one: a black picture is that dense
_MOST_RECORDS = 256  # of a chunk, beside two for each compressed byte: their times differ
_INSIDE: dict[int, Any] = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}


class UnchunkedError(Exception):
    """Messages lie outside chunks, where nothing but an index finds them in order."""


def has_sound_index(stream: BinaryIO, size: int) -> bool:
    """Return whether a file of so many bytes ends with a sound index; the library checks no CRC."""
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


def _content_of(chunk: Chunk) -> bytes:
    """Return a chunk's records; decompressed as far as it says, which is bounded by what it takes."""
    data, size, most = chunk.data, chunk.uncompressed_size, _MOST_BYTES + 1024 * len(chunk.data)
    if size > most:
        raise McapError(f"a chunk of {len(data)} bytes claims {size}; allowed are {most}")
    if chunk.compression == "zstd":
        if frame_content_size(data) > size:
            raise McapError("a chunk holds more than it claims")
        data = ZstdDecompressor().decompress(data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = LZ4FrameDecompressor().decompress(data, max_length=size)
    elif chunk.compression:
        raise McapError(f"a chunk is compressed by {chunk.compression!r}; allowed are zstd and lz4")
    if len(data) != size:
        raise McapError(f"a chunk claims {size} bytes and holds {len(data)}")
    return data


def records_of(chunk: Chunk, validate_crc: bool = False) -> list[Any]:  # noqa: FBT001, FBT002 - as the library calls it
    """Return a chunk's schemas, channels and messages, in work and memory bounded by its compressed size.

    Raises:
        McapError: It holds anything else, claims another size, or decompresses to far more than real ones do.
    """
    content = _content_of(chunk)
    if validate_crc and chunk.uncompressed_crc not in {0, zlib.crc32(content)}:
        raise McapError("a chunk's checksum is of other bytes")
    records: list[Any] = []
    at = 0
    while at < len(content):
        opcode, length = _RECORD_HEAD.unpack_from(content, at)
        start, at = at + _RECORD_HEAD.size, at + _RECORD_HEAD.size + length
        is_message = opcode == Opcode.MESSAGE and length >= _MESSAGE_HEAD.size
        if not (is_message or opcode in _INSIDE) or at > len(content):
            raise McapError(f"a chunk holds a record {opcode} of {length} bytes")
        if len(records) >= _MOST_RECORDS + 2 * len(chunk.data):
            raise McapError(
                f"a chunk of {len(chunk.data)} bytes holds more than {len(records)} records"
            )
        if is_message:
            channel, sequence, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content, start)
            data = content[start + _MESSAGE_HEAD.size : at]
            records.append(Message(channel, log_ns, data, publish_ns, sequence))
        else:
            records.append(_INSIDE[opcode].read(ReadDataStream(BytesIO(content[start:at]))))
    return records


def _own(name: str, **replaced: Any) -> Any:
    """Return an own copy of a module with these names replaced: whoever else uses the library keeps it."""
    spec = find_spec(name)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    vars(module).update(replaced)
    return module


# The library walks what a chunk decompresses to, however much; all its ways to a chunk's records lead here.
_STREAMS = _own("mcap.stream_reader", breakup_chunk=records_of)
_READERS = _own("mcap.reader", breakup_chunk=records_of, StreamReader=_STREAMS.StreamReader)
SeekingReader = _READERS.SeekingReader


def _add_definition(summary: Summary, record: Any) -> None:
    if isinstance(record, Schema):
        summary.schemas[record.id] = record
    elif isinstance(record, Channel):
        summary.channels[record.id] = record


def _add_chunk(summary: Summary, offset: int, content: bytes) -> None:
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    records = records_of(chunk, validate_crc=True)
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
            chunk_start_offset=offset,
            chunk_length=_RECORD_HEAD.size + len(content),
            message_index_offsets={},
            message_index_length=0,
            compressed_size=len(chunk.data),
            **_same(
                chunk, "message_start_time", "message_end_time", "compression", "uncompressed_size"
            ),
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
            data_size=len(found.data),
            **_same(found, "log_time", "create_time", "name", "media_type"),
        )
    )


def _same(record: Any, *names: str) -> dict[str, Any]:
    return {name: getattr(record, name) for name in names}


_INDEXERS: dict[int, Callable[[Summary, int, bytes], None]] = {
    Opcode.SCHEMA: lambda s, _, b: _add_definition(s, Schema.read(ReadDataStream(BytesIO(b)))),
    Opcode.CHANNEL: lambda s, _, b: _add_definition(s, Channel.read(ReadDataStream(BytesIO(b)))),
    Opcode.CHUNK: _add_chunk,
    Opcode.METADATA: _add_metadata,
    Opcode.ATTACHMENT: _add_attachment,
}


def scan(stream: BinaryIO, size: int) -> tuple[Summary, bool]:
    """Index a file's whole records, and return whether the data ends well; UnchunkedError outside chunks."""
    summary = Summary()
    counts: dict[str, Any] = {field.name: 0 for field in fields(Statistics)}
    summary.statistics = Statistics(**counts | {"channel_message_counts": defaultdict(int)})
    for offset, opcode, content in _whole_records(stream, size):
        if opcode == Opcode.MESSAGE:
            raise UnchunkedError
        if opcode == Opcode.DATA_END:
            return summary, True
        if opcode in _INDEXERS:
            try:
                _INDEXERS[opcode](summary, offset, content)
            except DAMAGE:
                break
    return summary, False
