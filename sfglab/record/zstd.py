"""Decompression of Zstandard that stops at an expected size."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zstandard import ZstdDecompressor, ZstdError, frame_content_size

if TYPE_CHECKING:
    from pathlib import Path

# The bound on what compressed bytes may become; a file of zeros is that dense.
_MOST_BYTES = 2**26
_MOST_RATIO = 1024


def decompress(data: bytes, most: int | None = None) -> bytes:
    """Return the content of one frame, at most so many bytes.

    Raises:
        ZstdError: The frame is damaged, or holds more.
    """
    if most is None:
        most = _MOST_BYTES + _MOST_RATIO * len(data)
    if frame_content_size(data) > most:
        raise ZstdError(f"{len(data)} compressed bytes hold more than {most}")
    return ZstdDecompressor().decompress(data, max_output_size=most)


def decompress_file(source: Path, target: Path) -> None:
    """Write the content of a compressed file into another one.

    Raises:
        ZstdError: The file is damaged, or holds far more than real ones do.
        OSError: A file cannot be read or written.
    """
    left = _MOST_BYTES + _MOST_RATIO * source.stat().st_size
    with source.open("rb") as compressed, target.open("wb") as plain:
        reader = ZstdDecompressor().stream_reader(compressed, read_across_frames=True)
        while part := reader.read(2**20):
            left -= len(part)
            if left < 0:
                raise ZstdError(f"{source.name} holds far more than its size allows")
            plain.write(part)
