"""RVL: lossless compression of 16-bit depth images, bit-exact with image_transport's.

A frame is a sequence of numbers: how many zeros, how many non-zeros, then each non-zero pixel as the zigzag
of its difference to the non-zero pixel before it (holes do not interrupt that chain). Each number is written
as nibbles of three bits, lowest first, the fourth bit saying that more follow; eight nibbles fill a 32-bit
little-endian word from its top. The tests' `rvl_reference` says the same in plain loops.

Knows this bitstream and nothing of the messages around it (`sfglab.codecs.depth`). Importing this module
imports numba and, the first time on a machine, compiles the kernels; no later call is ever cold.

Source: A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017; image_transport_plugins,
compressed_depth_image_transport, rvl_codec.cpp.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from sfglab.codecs.errors import MAX_PIXELS, BitstreamError, CodecError, check_size, kind_of
from sfglab.compiling import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FAULTS = {
    1: "the words end before the last pixel",
    2: "a number has more nibbles than any run or difference needs",
    3: "a run passes the last pixel",
    4: "a run of non-zero pixels holds a zero",
    5: "words follow the last pixel",
}


class RvlError(BitstreamError):
    """Bytes that no RVL encoder writes."""

    def __init__(self, *, reason: str, size_bytes: int, offset_bytes: int) -> None:
        self.offset_bytes = offset_bytes  #: Offset of the word in which the fault was noticed.
        super().__init__("rvl", reason=f"at byte {offset_bytes}, {reason}", size_bytes=size_bytes)


def encode(depth: NDArray[np.uint16]) -> bytes:
    """Compress a depth image, shape (rows, columns), uint16, without loss; 0 is "no reading".

    RVL words are at most about 1.5 times the size of the image. Raises CodecError where it is no such array of
    1 to `MAX_PIXELS` pixels.
    """
    if depth.ndim != 2 or depth.dtype.str[1:] != "u2" or not 0 < depth.size <= MAX_PIXELS:
        allowed = f"uint16 images of shape (rows, columns) with 1 to {MAX_PIXELS} pixels"
        raise CodecError(f"RVL encodes {allowed}; given {kind_of(depth)}")
    pixels = np.require(depth, np.uint16, ["C", "A"]).reshape(-1)
    # A run's length never has more nibbles than the run has pixels, and a pixel has at most six.
    words = np.empty((7 * pixels.size + 2) // 8 + 2, dtype=np.uint32)
    return words[: _encode_words(pixels, words, _DELTA_NIBBLES)].astype("<u4", copy=False).tobytes()


def decode(
    data: bytes | bytearray | memoryview,
    shape: tuple[int, int],
    *,
    out: NDArray[np.uint16] | None = None,
) -> NDArray[np.uint16]:
    """Restore a depth image; hostile bytes cost time and memory in proportion to `shape`, nothing more.

    Streams of writers that keep pixels as signed 16-bit numbers decode to the same values, because
    differences are taken modulo 2**16.

    Args:
        data: RVL words of exactly one image.
        shape: (rows, columns), which the bitstream does not hold.
        out: Receives the image, uint16, C-contiguous, of that shape; after an error its content is undefined.

    Returns:
        `out`, or a new array, shape (rows, columns).

    Raises:
        RvlError: If the words are cut, run past the image, end before it or go on after it.
        CodecError: If `out` does not fit.
    """
    size_bytes = memoryview(data).nbytes
    check_size("rvl", width=shape[1], height=shape[0], size_bytes=size_bytes)
    if size_bytes % 4:
        reason = "a word of 4 bytes is cut off"
        raise RvlError(reason=reason, size_bytes=size_bytes, offset_bytes=size_bytes // 4 * 4)
    words = np.require(np.frombuffer(data, "<u4"), np.uint32, ["C", "A"])
    pixels = _cleared(shape, out)
    fault, at, bits_left = _decode_words(words, pixels.reshape(-1))
    if fault:
        offset_bytes = (8 * at - bits_left // 4) // 8 * 4
        raise RvlError(reason=_FAULTS[fault], size_bytes=size_bytes, offset_bytes=offset_bytes)
    return pixels


def _cleared(shape: tuple[int, int], out: NDArray[np.uint16] | None) -> NDArray[np.uint16]:
    """Return an image of zeros: holes are skipped, so those of a new array are never even touched."""
    if out is None:
        return np.zeros(shape, dtype=np.uint16)
    if out.shape != shape or out.dtype != np.uint16 or not out.flags.carray:
        allowed = f"a writable, contiguous uint16 array of shape {shape}"
        raise CodecError(f"RVL decodes into {allowed}; given {kind_of(out)}")
    out.fill(0)
    return out


def _delta_nibbles() -> NDArray[np.int32]:
    """Return for each difference from -65535 the nibbles of its zigzag, shifted left by 5, plus their bits."""
    delta = np.arange(-65535, 65536, dtype=np.int32)
    rest = np.where(delta >= 0, 2 * delta, -2 * delta - 1)
    table = np.zeros_like(rest)
    unfinished = np.ones_like(rest, dtype=bool)
    for count in range(1, 7):
        more = rest >= 8
        code = table >> 5 << 4 | rest & 7 | np.where(more, 8, 0)
        table = np.where(unfinished, code << 5 | 4 * count, table)
        unfinished &= more
        rest >>= 3
    return table.astype(np.int32)


_DELTA_NIBBLES = _delta_nibbles()


# In both kernels only the lowest `bits` bits of `window` count; what stands above them is left to overflow.


@numba.njit
def _put(number: Any, words: Any, state: Any) -> Any:
    """Write a number of any size; `state` is (words written, window, bits in the window)."""
    at, window, bits = state
    more = True
    while more:
        more = number >= 8
        window = window << 4 | number & 7 | more << 3
        number >>= 3
        bits += 4
        if bits == 32:
            words[at] = window & 0xFFFFFFFF
            at += 1
            bits = 0
    return at, window, bits


@compiled(
    "int64(Array(uint16, 1, 'C', readonly=True), uint32[::1], Array(int32, 1, 'C', readonly=True))"
)
def _encode_words(pixels: Any, words: Any, table: Any) -> Any:
    """Encode all pixels into 32-bit words and return the number of words."""
    count = len(pixels)
    at = 0
    window = 0
    bits = 0
    previous = np.int64(0)
    end = 0
    while end < count:
        start = end
        while end < count and pixels[end] == 0:
            end += 1
        at, window, bits = _put(end - start, words, (at, window, bits))
        start = end
        while end < count and pixels[end] != 0:
            end += 1
        at, window, bits = _put(end - start, words, (at, window, bits))
        for index in range(start, end):
            pixel = np.int64(pixels[index])
            entry = np.int64(table[pixel - previous + 65535])
            previous = pixel
            window = window << (entry & 31) | entry >> 5
            bits += entry & 31
            # Stored whether or not the word is full: cheaper than a branch that is wrong half the time.
            words[at] = window >> (bits & 31) & 0xFFFFFFFF
            at += bits >> 5
            bits &= 31
    if bits:
        words[at] = window << (32 - bits) & 0xFFFFFFFF
        at += 1
    return at


@numba.njit
def _get(words: Any, state: Any) -> Any:
    """Read a number; `state` is (words read, window, bits in the window); a negative number is a fault."""
    at, window, bits = state
    number = 0
    for shift in range(0, 30, 3):
        if bits == 0:
            if at == len(words):
                return -1, (at, window, bits)
            window = np.int64(words[at])
            at += 1
            bits = 32
        bits -= 4
        nibble = window >> bits & 15
        number |= (nibble & 7) << shift
        if nibble < 8:
            return number, (at, window, bits)
    return -2, (at, window, bits)


@compiled("Tuple((int64, int64, int64))(Array(uint32, 1, 'C', readonly=True), uint16[::1])")
def _decode_words(words: Any, pixels: Any) -> Any:  # noqa: C901, PLR0911  # one loop that each fault leaves
    """Fill non-zero pixels, with `_get` written out for speed; return (fault or 0, words, unused bits)."""
    count = len(pixels)
    at = 0
    window = 0
    bits = 0
    previous = 0
    end = 0
    while end < count:
        zeros, (at, window, bits) = _get(words, (at, window, bits))
        run, (at, window, bits) = (
            (0, (at, window, bits)) if zeros < 0 else _get(words, (at, window, bits))
        )
        if zeros < 0 or run < 0:
            return -min(zeros, run), at, bits
        start = end + zeros
        end = start + run
        if end > count:
            return 3, at, bits
        for index in range(start, end):
            if bits < 24 and at < len(words):
                window = window << 32 | np.int64(words[at])
                at += 1
                bits += 32
            number = 0
            shift = 0
            nibble = 8
            while nibble >= 8:
                if shift == 18:  # six nibbles, which the window holds unless the words are over
                    return 2, at, bits
                if bits == 0:
                    return 1, at, bits
                bits -= 4
                nibble = window >> bits & 15
                number |= (nibble & 7) << shift
                shift += 3
            previous = previous + (number >> 1 ^ -(number & 1)) & 0xFFFF
            if previous == 0:
                return 4, at, bits
            pixels[index] = previous
    if at < len(words) or bits >= 32:
        return 5, at - (bits >> 5), 0
    return 0, at, bits
