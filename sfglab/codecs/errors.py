"""The errors of all codecs and the size that no decoder exceeds."""

from __future__ import annotations

from typing import Any

from sfglab.errors import SfglabError

MAX_PIXELS = 2**26
"""Largest frame that is decoded (8192 x 8192), so that a malicious header cannot request more memory."""


class CodecError(SfglabError, ValueError):
    """An image, a packet or a setting that a codec cannot encode or decode."""


class CodecUnavailableError(CodecError):
    """No usable encoder or decoder of the wanted name, or for the wanted format."""

    def __init__(self, wanted: str, *, reason: str) -> None:
        self.wanted = wanted  #: Name of the codec or format.
        self.reason = reason  #: Cause, as a phrase.
        super().__init__(f"codec {wanted!r}: {reason}")


class BitstreamError(CodecError):
    """Bytes that are not a valid frame of the named format."""

    def __init__(self, codec: str, *, reason: str, size_bytes: int) -> None:
        self.codec = codec  #: Expected format, such as ``"h264"`` or ``"png"``.
        self.reason = reason  #: Cause, as a phrase.
        self.size_bytes = size_bytes  #: Size of the input in bytes.
        super().__init__(f"{codec} frame of {size_bytes} bytes: {reason}")


def kind_of(array: Any) -> str:
    """Return an array's type and shape as text for error messages."""
    return f"{array.dtype} of shape {array.shape}"


def check_size(
    codec: str, *, width: int, height: int, size_bytes: int, most_pixels: int = MAX_PIXELS
) -> None:
    """Check the size that a header claims, before memory is allocated for the image.

    Args:
        codec: Format of the data.
        width: Pixels per row.
        height: Rows.
        size_bytes: Size of the data with the header, bytes.
        most_pixels: Largest number of pixels.

    Raises:
        BitstreamError: A side is below 1, or the image has more than `most_pixels`.
    """
    if width < 1 or height < 1 or width * height > most_pixels:
        reason = f"claims {width} x {height} pixels; allowed: sides from 1 and at most {most_pixels} pixels"
        raise BitstreamError(codec, reason=reason, size_bytes=size_bytes)
