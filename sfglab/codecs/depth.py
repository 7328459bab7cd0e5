"""Depth images as compressed_depth_image_transport writes them: a 12-byte header, then PNG or RVL.

16-bit depth is stored without loss and keeps all distances, while the ROS plugin by default turns distances beyond
10 m into holes. 32-bit depth, which the plugin quantises to 16 bits, can be read but not written.

Source: image_transport_plugins, compressed_depth_image_transport: codec.cpp, compression_common.h.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs.errors import MAX_PIXELS, BitstreamError, CodecError, kind_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

PNG_LEVEL = 9
"""The plugin's default (``png_level``), which takes 20 to 50 times as long as level 1 to
save a tenth to a fifth of the bytes."""

_HEADER = struct.Struct("<iff")  # format, depthQuantA, depthQuantB
_INV_DEPTH = 0
_SIZE = struct.Struct("<II")  # columns, rows; a PNG has its own


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthFormat:
    """Content of the `format` field of a compressed depth message; `str()` is its text.

    Raises:
        CodecError: The codec is neither ``"png"`` nor ``"rvl"``.
    """

    encoding: str  #: ROS image encoding such as ``"16UC1"``; empty if the message has none.
    codec: str  #: ``"png"`` or ``"rvl"``.

    def __post_init__(self) -> None:
        if self.codec not in ("png", "rvl"):
            allowed = "allowed: 'png', 'rvl'"
            raise CodecError(f"codec of compressedDepth: given {self.codec!r}, {allowed}")

    def __str__(self) -> str:
        return f"{self.encoding}; compressedDepth {self.codec}"


def parse_depth_format(text: str) -> DepthFormat:
    """Return the content of a `format` field, such as ``16UC1; compressedDepth rvl``, in any case.

    A text without a codec means PNG.

    Raises:
        CodecError: The text has another form, or names another codec.
    """
    encoding, _, transport = text.rpartition(";")
    words = transport.lower().split()
    if len(words) not in (1, 2) or words[0] != "compresseddepth":
        allowed = "'<encoding>; compressedDepth' followed by 'png' or 'rvl'"
        raise CodecError(f"depth format: given {text!r}, allowed: {allowed}")
    codec = words[1] if len(words) == 2 else "png"
    return DepthFormat(encoding=encoding.strip(), codec=codec)


def encode_depth(
    depth_mm: NDArray[np.uint16], *, codec: str = "rvl", png_level: int = PNG_LEVEL
) -> tuple[DepthFormat, bytes]:
    """Return a depth image as the `format` and the `data` of a compressed depth message.

    Args:
        depth_mm: Shape (rows, columns), uint16, in millimetres with 0 for holes.
        codec: ``"rvl"`` or ``"png"``.
        png_level: Effort of zlib for PNG, from 0 to 9.

    Raises:
        CodecError: The image has another shape or type, or the codec is another one.
    """
    if depth_mm.ndim != 2 or depth_mm.dtype != np.uint16 or not depth_mm.size:
        allowed = "allowed: uint16 of two dimensions, not empty"
        raise CodecError(f"depth image: given {kind_of(depth_mm)}, {allowed}")
    depth_format = DepthFormat(encoding="16UC1", codec=codec)
    # The plugin leaves A and B unset here and ignores them; a viewer may take anything but 0 as quantised.
    header = _HEADER.pack(_INV_DEPTH, 0.0, 0.0)
    return depth_format, header + _compressed(depth_mm, codec, png_level)


def decode_depth(
    data: bytes, depth_format: DepthFormat, *, most_pixels: int = MAX_PIXELS
) -> tuple[NDArray[Any], str]:
    """Return a depth image, shape (rows, columns), and its ROS encoding.

    Pixels are uint16 as they were written, with 0 for holes; or, if they were quantised, float32 in metres
    with NaN for holes.

    Args:
        data: The `data` of the message.
        depth_format: Content of its `format`.
        most_pixels: Largest number of pixels; a larger image is refused.

    Raises:
        BitstreamError: The data are cut off, damaged, or claim too large an image.
    """
    if len(data) <= _HEADER.size:
        raise BitstreamError(
            "compressedDepth", reason="shorter than its header", size_bytes=len(data)
        )
    _, quant_a, quant_b = _HEADER.unpack_from(data)
    pixels = _decompressed(memoryview(data)[_HEADER.size :], depth_format.codec, most_pixels)
    quantised = "32" in depth_format.encoding or (not depth_format.encoding and quant_a != 0)
    if not quantised:
        return pixels, depth_format.encoding or "16UC1"
    if not (0 < quant_a < math.inf and math.isfinite(quant_b)):
        allowed = "allowed: a positive A and a finite B"
        reason = f"quantised with A = {quant_a}, B = {quant_b}; {allowed}"
        raise BitstreamError("compressedDepth", reason=reason, size_bytes=len(data))
    return _metres(pixels, quant_a, quant_b), depth_format.encoding or "32FC1"


def _metres(pixels: NDArray[np.uint16], quant_a: float, quant_b: float) -> NDArray[np.float32]:
    """Return d = A / (q - B), and NaN for holes."""
    with np.errstate(divide="ignore", over="ignore"):
        depth_m = np.float32(quant_a) / (pixels.astype(np.float32) - np.float32(quant_b))
    depth_m[pixels == 0] = np.nan
    return depth_m


def _compressed(pixels: NDArray[np.uint16], codec: str, png_level: int) -> bytes:
    if codec == "png":
        from sfglab.codecs.still import encode_png

        return encode_png(pixels, level=png_level)
    from sfglab.codecs.rvl import encode  # with Numba, whose import takes 0.3 s

    return _SIZE.pack(pixels.shape[1], pixels.shape[0]) + encode(pixels)


def _decompressed(body: memoryview, codec: str, most_pixels: int) -> NDArray[np.uint16]:
    if codec == "rvl":
        return _from_rvl(body, most_pixels)
    from sfglab.codecs.still import decode_still

    image = decode_still(bytes(body), most_pixels=most_pixels)
    if image.ndim != 2 or image.dtype != np.uint16:
        reason = f"holds {kind_of(image)}; depth is one channel of 16 bits"
        raise BitstreamError("png", reason=reason, size_bytes=len(body))
    return image


def _from_rvl(body: memoryview, most_pixels: int) -> NDArray[np.uint16]:
    """Decode columns and rows, which are not part of RVL, and the RVL words that follow."""
    from sfglab.codecs.rvl import decode

    if len(body) < _SIZE.size:
        raise BitstreamError("rvl", reason="cut before the image size", size_bytes=len(body))
    columns, rows = _SIZE.unpack_from(body)
    return decode(body[_SIZE.size :], (rows, columns), most_pixels=most_pixels)
