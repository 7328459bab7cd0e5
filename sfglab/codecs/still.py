"""Still images: PNG and JPEG through OpenCV. The size that a file claims is checked before memory is allocated.

The module handles neither messages (`sfglab.codecs.carriers`) nor depth (`sfglab.codecs.depth`). The libraries below
OpenCV write a line to stderr for each damaged image, which Python cannot prevent.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.codecs.errors import MAX_PIXELS, BitstreamError, CodecError, check_size, kind_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

_JPEG_QUALITY = 95  # the default of compressed_image_transport
_PNG_START = b"\x89PNG\r\n\x1a\n"
_JPEG_START = b"\xff\xd8"


def encode_png(image: NDArray[Any], *, level: int) -> bytes:
    """Return an image as a PNG file.

    Args:
        image: Pixels of shape (rows, columns) or (rows, columns, 3 or 4), uint8 or uint16, colours as BGR(A).
        level: Effort of zlib, from 0 to 9.

    Raises:
        CodecError: PNG cannot hold pixels of this shape or type.
    """
    return _encode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, level])


def encode_jpeg(image: NDArray[np.uint8]) -> bytes:
    """Return an image, shape (rows, columns) or (rows, columns, 3), uint8, BGR, as a JPEG file of quality 95.

    Raises:
        CodecError: JPEG cannot hold pixels of this shape or type.
    """
    return _encode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])


def decode_still(data: bytes, *, most_pixels: int = MAX_PIXELS) -> NDArray[Any]:
    """Return the pixels of a PNG or JPEG file, in the shapes and types that `encode_png` accepts.

    A flipped bit in a PNG is always detected. JPEG has no checksum, so damage inside its scan is visible only in
    the image.

    Raises:
        BitstreamError: The data are neither PNG nor JPEG, are damaged, or claim more than `most_pixels`.
    """
    codec, width, height = _claim(data)
    check_size(codec, width=width, height=height, size_bytes=len(data), most_pixels=most_pixels)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BitstreamError(codec, reason=f"OpenCV: {error.err}", size_bytes=len(data)) from error
    if image is None:
        raise BitstreamError(codec, reason="OpenCV finds it cut or damaged", size_bytes=len(data))
    return image


def _encode(suffix: str, image: NDArray[Any], parameters: list[int]) -> bytes:
    try:
        _, encoded = cv2.imencode(suffix, image, parameters)
    except cv2.error as error:
        raise CodecError(f"{suffix} cannot hold {kind_of(image)}: {error.err}") from error
    return bytes(encoded)


def _claim(data: bytes) -> tuple[str, int, int]:
    """Return the format, width and height that the header claims."""
    if data.startswith(_PNG_START):
        return ("png", *_png_size(data))
    if data.startswith(_JPEG_START):
        return ("jpeg", *_jpeg_size(data))
    start = data[:8].hex(" ") or "nothing"
    raise BitstreamError(
        "png or jpeg", reason=f"starts with {start}, which is neither", size_bytes=len(data)
    )


def _png_size(data: bytes) -> tuple[int, int]:
    """Walk all chunks (PNG 3, clause 5.3), because OpenCV allocates what their lengths claim."""
    at = len(_PNG_START)
    while at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IEND" and end <= len(data) and data[12:16] == b"IHDR":
            width, height = struct.unpack_from(">II", data, 16)
            return width, height
        at = end
    raise BitstreamError("png", reason="cut, or a chunk passes the end", size_bytes=len(data))


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Walk the marker segments to the start of frame (ITU-T T.81, clause B.2.2)."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    raise BitstreamError("jpeg", reason="no start of frame in the header", size_bytes=len(data))
