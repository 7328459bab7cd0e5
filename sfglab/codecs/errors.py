"""The errors of all codecs and the size that no decoder exceeds."""

from __future__ import annotations

from typing import Any

from sfglab.errors import SfglabError

MAX_PIXELS = 2**26
"""Largest frame that is decoded (8192 x 8192), so that a hostile header cannot ask for more memory."""


class CodecError(SfglabError, ValueError):
    """Anything that a codec refuses to encode or decode."""


class CodecUnavailableError(CodecError):
    """No usable encoder or decoder of the wanted name, or for the wanted format."""

    def __init__(self, wanted: str, *, reason: str) -> None:
        self.wanted = wanted  #: Name of the codec or format.
        self.reason = reason  #: Reason.
        super().__init__(f"codec {wanted!r}: {reason}")


class BitstreamError(CodecError):
    """Bytes that are not a valid frame of the named format."""

    def __init__(self, codec: str, *, reason: str, size_bytes: int) -> None:
        self.codec = codec  #: The format that was being read, such as ``"h264"`` or ``"png"``.
        self.reason = reason  #: Reason.
        self.size_bytes = size_bytes  #: Size of the input in bytes.
        super().__init__(f"{codec} frame of {size_bytes} bytes: {reason}")


def kind_of(array: Any) -> str:
    """Return an array's type and shape, for messages."""
    return f"{array.dtype} of shape {array.shape}"


def check_size(
    codec: str, *, width: int, height: int, size_bytes: int, most_pixels: int = MAX_PIXELS
) -> None:
    """Refuse, as a BitstreamError, a size above `most_pixels` that a header in `size_bytes` of data claims."""
    if width < 1 or height < 1 or width * height > most_pixels:
        reason = f"claims {width} x {height} pixels; allowed are sides from 1 and at most {most_pixels} pixels"
        raise BitstreamError(codec, reason=reason, size_bytes=size_bytes)
