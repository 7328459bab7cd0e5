"""A lossless format of our own for 16-bit depth, smaller than RVL at its speed: predict, then Zstandard.

A pixel is predicted from its left, upper and upper left neighbours by the median edge detector of JPEG-LS; a
hole counts there as the last depth to its left, or as what is above where a row begins with it, so that edges
of holes cost nothing; above the first row all is 1. Each pixel is one byte: 0 a hole, 1 to 254 one more than
the zigzag of its difference to the prediction, 255 a value that follows, as 16 bits, little-endian, in the
pixels' order, behind the bytes of all pixels. All of it is one Zstandard frame that says its size.

Knows this and nothing of the messages around it (`sfglab.codecs.depth`). Importing this module compiles the
kernels the first time on a machine.

Source: M. J. Weinberger, G. Seroussi, G. Sapiro, The LOCO-I Lossless Image Compression Algorithm, 2000
(the predictor); RFC 8878 (Zstandard).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import zstandard
from numpy import int32

from sfglab.codecs.errors import BitstreamError, check_size
from sfglab.compiling import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Differences have few repetitions worth a search, so long matches only: a third of level 1's time, and smaller.
_PARAMETERS = zstandard.ZstdCompressionParameters.from_level(
    1, strategy=zstandard.STRATEGY_FAST, min_match=7, hash_log=6
)
_FAULTS = {
    1: "more pixels than values follow",
    2: "a pixel is neither a hole nor 1 to 65535",
    3: "values are left",
}


def encode(depth: NDArray[np.uint16]) -> bytes:
    """Compress depth (rows, columns), uint16, without loss, 0 no reading; BitstreamError for a wrong size."""
    rows, columns = depth.shape
    check_size("med", width=columns, height=rows, size_bytes=depth.nbytes)
    content = np.empty(3 * depth.size + 1, np.uint8)  # one byte more, for a value never written
    values = np.empty(depth.size + 1, "<u2")
    pixels = np.require(depth, np.uint16, ["C", "A"])
    count = _predict(pixels, content[: depth.size], values, np.ones((2, columns + 1), np.int32))
    size = depth.size + 2 * count
    content[depth.size : size] = values[:count].view(np.uint8)
    return zstandard.ZstdCompressor(compression_params=_PARAMETERS).compress(content[:size].data)


def decode(data: bytes | memoryview, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Restore a depth image of a shape (rows, columns), which the frame does not hold.

    Hostile bytes cost time and memory in proportion to the shape, nothing more. Raises BitstreamError where
    they are no frame of exactly one such image.
    """
    pixels = shape[0] * shape[1]
    check_size("med", width=shape[1], height=shape[0], size_bytes=len(data))
    content = np.frombuffer(_unpacked(bytes(data), pixels), np.uint8)
    depth = np.empty(shape, np.uint16)
    values = np.require(content[pixels:].copy().view("<u2"), np.uint16)
    fault = _restore(content[:pixels], values, depth, np.ones(shape[1], np.int32))
    if fault:
        raise BitstreamError("med", reason=_FAULTS[fault], size_bytes=len(data))
    return depth


def _unpacked(data: bytes, pixels: int) -> bytes:
    """Return a frame's content, of a size that so many pixels can have, which is looked at first."""
    try:
        size = zstandard.frame_content_size(data)
        if not pixels <= size <= 3 * pixels or (size - pixels) % 2:
            reason = f"holds {size} bytes; {pixels} pixels have as many, and two more for each that follows"
            raise BitstreamError("med", reason=reason, size_bytes=len(data))
        return zstandard.ZstdDecompressor().decompress(data, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise BitstreamError("med", reason=str(error), size_bytes=len(data)) from error


# Numba makes 64 bits of every sum; half as many go twice as fast, and no number here needs more.


@compiled("int64(Array(uint16, 2, 'C', readonly=True), uint8[::1], uint16[::1], int32[:, ::1])")
def _predict(pixels: Any, codes: Any, values: Any, lines: Any) -> Any:
    """Write pixels' bytes and the values that follow, and count these; `lines` are two rows without holes."""
    rows, columns = pixels.shape
    count = 0
    for y in range(rows):
        above, line, row = lines[y & 1], lines[1 - (y & 1)], pixels[y]
        out = codes[y * columns : (y + 1) * columns]
        last = above[1]
        above[0] = line[0] = last
        for x in range(columns):
            pixel = int32(row[x])
            last = pixel if pixel != 0 else last
            line[x + 1] = last
        beyond = 0
        for x in range(columns):  # eight at once: no branch, and nothing of the pixel before
            left, up, corner, pixel = line[x], above[x + 1], above[x], int32(row[x])
            low, high = (min(up, left)), (max(left, up))
            guess = int32(int32(left + up) - corner)
            guess = max(guess, low)
            guess = min(guess, high)
            change = int32(pixel - guess)
            code = int32(int32(int32(change << 1) ^ int32(change >> 31)) + 1)
            code = int32(255) if code > 254 else code
            code = int32(0) if pixel == 0 else code
            beyond += code == 255
            out[x] = np.uint8(code)
        if beyond:
            for x in range(columns):
                values[count] = row[x]
                count += out[x] == 255
    return count


@compiled(
    "int64(Array(uint8, 1, 'C', readonly=True), Array(uint16, 1, 'C', readonly=True), "
    "uint16[:, ::1], int32[::1])"
)
def _restore(codes: Any, values: Any, pixels: Any, above: Any) -> Any:
    """Fill in all pixels; return a fault or 0. `above` is the row before, without holes."""
    rows, columns = pixels.shape
    at = count = 0
    bits = int32(0)
    for y in range(rows):
        left = corner = int32(above[0])
        row = pixels[y]
        for x in range(columns):
            up, code = above[x], int32(codes[at])
            at += 1
            low, high = (min(up, left)), (max(left, up))
            guess = int32(left + int32(up - corner))
            guess = max(guess, low)
            guess = min(guess, high)
            if code == 0:
                row[x] = 0
            else:
                if code < 255:
                    code = int32(code - 1)
                    left = int32(guess + int32(int32(code >> 1) ^ int32(-int32(code & 1))))
                elif count < len(values):
                    left = int32(values[count])
                    count += 1
                else:
                    return 1
                bits |= int32(
                    left | int32(left - 1)
                )  # anything from bit 16 on: below 1, or above 65535
                row[x] = left
            corner = up
            above[x] = left
    if bits >> 16:
        return 2
    return 0 if count == len(values) else 3
