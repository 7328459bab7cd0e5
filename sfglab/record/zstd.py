"""Decompression of Zstandard that stops at an expected size."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zstandard import ZstdDecompressor, ZstdError, frame_content_size

if TYPE_CHECKING:
    from pathlib import Path


def most_bytes(compressed: int) -> int:
    """Return a bound on the size of what is compressed to a number of bytes.

    A black picture takes a thousandth of its size.
    """
    return 2**26 + 1024 * compressed


def decompress(data: bytes, most: int) -> bytes:
    """Return the content of one frame, at most so many bytes.

    Raises:
        ZstdError: The frame is damaged, or holds more.
    """
    if frame_content_size(data) > most:
        raise ZstdError(f"{len(data)} compressed bytes hold more than {most}")
    return ZstdDecompressor().decompress(data, max_output_size=most)


def decompress_file(source: Path, target: Path) -> None:
    """Write the content of a compressed file into another one.

    Raises:
        ZstdError: The file is damaged, or holds far more than real ones do.
        OSError: A file cannot be read or written.
    """
    most = most_bytes(source.stat().st_size)
    with source.open("rb") as compressed, target.open("wb") as plain:
        reader = ZstdDecompressor().stream_reader(compressed, read_across_frames=True)
        while part := reader.read(2**20):
            if plain.tell() > most:
                raise ZstdError(f"{source.name} holds far more than its size allows")
            plain.write(part)
