"""Entry points of H.264 and H.265 byte streams, at which a decoder can start.

Knows start codes and NAL unit types. Refuses to decode anything.

Source: ITU-T H.264, Annex B and table 7-1; ITU-T H.265, Annex B and table 7-1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


_H264_ENTRY = frozenset({5, 7})  # IDR slice, sequence parameter set
_H265_ENTRY = frozenset({*range(16, 24), 32, 33})  # IRAP slices, video and sequence parameter sets


def has_start_code(data: bytes) -> bool:
    """Return whether the bytes start as Annex B demands, and not with a length as in MP4 files."""
    return data.startswith((b"\0\0\1", b"\0\0\0\1"))


def nal_unit_types(data: bytes, *, codec: str) -> Iterator[int]:
    """Yield the type of each NAL unit in an Annex B byte stream.

    Args:
        data: Bytes with start codes.
        codec: ``"h264"`` or ``"hevc"``, which differ in where the type stands.

    Yields:
        Types as the tables 7-1 of the two standards number them.
    """
    at = data.find(b"\0\0\1")
    while 0 <= at < len(data) - 3:
        header = data[at + 3]
        yield header & 0x1F if codec == "h264" else header >> 1 & 0x3F
        at = data.find(b"\0\0\1", at + 3)


def is_entry_point(data: bytes, *, codec: str) -> bool:
    """Return whether a decoder that knows nothing may start with this access unit.

    True with a slice that refers to no earlier frame, and with parameter sets, because some writers send
    those in a packet of their own.
    """
    wanted = _H264_ENTRY if codec == "h264" else _H265_ENTRY
    return any(kind in wanted for kind in nal_unit_types(data, codec=codec))
