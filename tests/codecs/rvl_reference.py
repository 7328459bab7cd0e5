"""RVL as its paper writes it: one nibble at a time, nothing clever.

The readable twin of `sfglab.codecs.rvl`: the tests hold the fast codec against it bit by bit, and the
benchmark compiles it with numba as the plain scalar baseline. Trusts its input; never give it bytes from a
network.

Source: A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017, with pixels as unsigned 16-bit
numbers, as image_transport's RVL has them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def encode_nibbles(pixels: NDArray[np.uint16], nibbles: NDArray[np.uint8]) -> int:
    """Write depth pixels as nibbles, not packed, 8 a pixel and 8 more at most; return how many were written."""
    written = 0
    previous = 0
    at = 0
    while at < len(pixels):
        zeros = 0
        while at + zeros < len(pixels) and pixels[at + zeros] == 0:
            zeros += 1
        at += zeros
        nonzeros = 0
        while at + nonzeros < len(pixels) and pixels[at + nonzeros] != 0:
            nonzeros += 1
        for index in range(-2, nonzeros):  # the two run lengths, then the pixels
            if index == -2:
                value = zeros
            elif index == -1:
                value = nonzeros
            else:
                delta = int(pixels[at + index]) - previous
                previous = int(pixels[at + index])
                value = 2 * delta if delta >= 0 else -2 * delta - 1
            while True:
                nibbles[written] = value % 8 + (8 if value >= 8 else 0)
                written += 1
                value //= 8
                if value == 0:
                    break
        at += nonzeros
    return written


def decode_nibbles(nibbles: NDArray[np.uint8], pixels: NDArray[np.uint16]) -> int:
    """Read nibbles back into depth pixels and return how many were read."""
    read = 0
    previous = 0
    at = 0
    run = 0
    # what comes next: -2 and -1 are the two run lengths, from 0 on it is a pixel of the run
    index = -2
    while at < len(pixels):
        value = 0
        scale = 1
        while True:
            nibble = int(nibbles[read])
            read += 1
            value += nibble % 8 * scale
            scale *= 8
            if nibble < 8:
                break
        if index == -2:
            pixels[at : at + value] = 0
            at += value
        elif index == -1:
            run = value
        else:
            previous += value // 2 if value % 2 == 0 else -(value + 1) // 2
            pixels[at] = previous
            at += 1
        index += 1
        if index == run:
            index = -2
            run = 0
    return read
