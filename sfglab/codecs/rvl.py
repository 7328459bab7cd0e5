"""RVL: lossless compression of 16-bit depth images, bit-exact with image_transport's.

A frame is a sequence of numbers. Each run begins with the number of zeros and the number of non-zeros. The non-zero
pixels follow, each as the zigzag code of its difference to the non-zero pixel before it, which may be before the
zeros. A number is written as nibbles with three of its bits each, lowest bits first; a nibble's fourth bit is set if
more nibbles follow. Eight nibbles fill a 32-bit little-endian word from its top. The tests have the same format in
plain loops (`rvl_reference`).

The module handles the bitstream; `sfglab.codecs.depth` handles the messages around it. The import of this module
loads Numba and, the first time on a machine, compiles the kernels, so that no call has to compile.

Source: A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017; image_transport_plugins,
compressed_depth_image_transport, rvl_codec.cpp.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from sfglab.codecs.errors import MAX_PIXELS, BitstreamError, check_size
from sfglab.compiling import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray


def encode(depth: NDArray[np.uint16]) -> bytes:
    """Compress a depth image, shape (rows, columns), uint16, without loss, and return its RVL words.

    A pixel of 0 is a hole, a pixel without a measurement. The words take at most about 1.5 times the size of
    the image.
    """
    pixels = np.require(depth, np.uint16, ["C", "A"]).reshape(-1)
    # A run's length never has more nibbles than the run has pixels, and a pixel has at most six.
    words = np.empty((7 * pixels.size + 2) // 8 + 2, dtype=np.uint32)
    return words[: _encode_words(pixels, words, _DELTA_NIBBLES)].astype("<u4", copy=False).tobytes()


def decode(
    data: bytes | memoryview, shape: tuple[int, int], *, most_pixels: int = MAX_PIXELS
) -> NDArray[np.uint16]:
    """Return the depth image, shape `shape`, uint16, of RVL words.

    Even for malicious bytes, time and memory grow at most in proportion to the number of pixels.

    Streams of writers that keep pixels as signed 16-bit numbers decode to the same values, because
    differences are taken modulo 2**16.

    Args:
        data: RVL words of exactly one image.
        shape: (rows, columns), which the bitstream does not hold.
        most_pixels: Largest number of pixels.

    Raises:
        BitstreamError: The image is too large, or the words are cut off or encode another number of pixels.
    """
    rows, columns = shape
    size_bytes = len(data)
    check_size("rvl", width=columns, height=rows, size_bytes=size_bytes, most_pixels=most_pixels)
    pixels = np.zeros(shape, dtype=np.uint16)  # the kernel skips holes and does not write them
    words = np.frombuffer(data, "<u4", size_bytes // 4)
    words = np.require(words, np.uint32, ["C", "A"])
    if size_bytes % 4 or not _decode_words(words, pixels.reshape(-1)):
        reason = f"damaged: no words of one image of {columns} x {rows} pixels"
        raise BitstreamError("rvl", reason=reason, size_bytes=size_bytes)
    return pixels


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


# In both kernels only the lowest `bits` bits of `window` count; the bits above them may overflow.


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
            # The word is stored even if it is not full, because a branch would be mispredicted half of the time.
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
                break
            window = np.int64(words[at])
            at += 1
            bits = 32
        bits -= 4
        nibble = window >> bits & 15
        number |= (nibble & 7) << shift
        if nibble < 8:
            return number, (at, window, bits)
    return -1, (at, window, bits)


@compiled("boolean(Array(uint32, 1, 'C', readonly=True), uint16[::1])")
def _decode_words(words: Any, pixels: Any) -> Any:
    """Fill non-zero pixels, with `_get` written out for speed; return whether the words fit the image."""
    count = len(pixels)
    at = 0
    window = 0
    bits = 0
    previous = 0
    end = 0
    while end < count:
        zeros, (at, window, bits) = _get(words, (at, window, bits))
        if zeros < 0:
            return False
        run, (at, window, bits) = _get(words, (at, window, bits))
        start = end + zeros
        end = start + run
        if run < 0 or end > count:
            return False
        for index in range(start, end):
            if bits < 24 and at < len(words):
                window = window << 32 | np.int64(words[at])
                at += 1
                bits += 32
            number = 0
            shift = 0
            nibble = 8
            while nibble >= 8:
                # Six nibbles, which the window holds unless the words are over.
                if shift == 18 or bits == 0:
                    return False
                bits -= 4
                nibble = window >> bits & 15
                number |= (nibble & 7) << shift
                shift += 3
            previous = previous + (number >> 1 ^ -(number & 1)) & 0xFFFF
            if previous == 0:
                return False
            pixels[index] = previous
    return at == len(words) and bits < 32
