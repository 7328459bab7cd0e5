"""A number that is visible in the pixels of a frame, so that a subscriber can prove which frame it holds.

It is drawn as a row of black and white cells along the upper edge: one white and one black cell to calibrate
the threshold, 24 bits of number (most significant first) and an 8-bit check (of CRC-32). A cell is 16 pixels
wide and high, one H.264 macroblock, so that a 4 Mbit/s stream keeps it readable; depth images keep it as well.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from numpy.typing import NDArray

CELL_PX = 16  #: Side of a cell in pixels: one macroblock of H.264 (ITU-T H.264, clause 3).

NUMBER_BITS = 24
CHECK_BITS = 8
#: Cells in the row: white, black, 24 number bits, 8 check bits.
CELLS = 2 + NUMBER_BITS + CHECK_BITS

_BIT_SHIFTS = np.arange(NUMBER_BITS + CHECK_BITS - 1, -1, -1)
_DIGITS = tuple(bytes(48 + (value > threshold) for value in range(256)) for threshold in range(256))
"""Translations of a byte to the digit 0 or 1, by threshold."""

_MIDDLE = CELL_PX // 2  # a cell is read in its middle: ringing lives at its edges


def _check(number: int) -> int:
    """Return the low byte of the CRC-32 of a 24-bit number."""
    return zlib.crc32(number.to_bytes(3, "big")) & 0xFF


def _cell_area(image: NDArray[Any]) -> NDArray[Any]:
    """Return the strip of the image that holds the cells, one plane, shape (16, 16 * CELLS)."""
    height, width = image.shape[:2]
    if height < CELL_PX or width < CELLS * CELL_PX:
        given, allowed = (
            f"an image of {width} x {height}",
            f"at least {CELLS * CELL_PX} x {CELL_PX} pixels",
        )
        raise InvalidValueError("frame number", given, allowed)
    return image[:CELL_PX, : CELLS * CELL_PX]


def stamp_number(image: NDArray[Any], number: int, *, white: int = 235, black: int = 16) -> None:
    """Draw a number, 0 to 2**24 - 1, into the upper edge of an image, in place, or raise `InvalidValueError`.

    The image has shape (H, W) or (H, W, channels), any integer type, at least 544 x 16 pixels; white and black
    are values in its own unit (millimetres for depth) whose most significant bytes differ.
    """
    if not 0 <= number < 1 << NUMBER_BITS:
        raise InvalidValueError("frame number", number, f"0 to {(1 << NUMBER_BITS) - 1}")
    word = (number << CHECK_BITS) | _check(number)
    bits = np.concatenate(([1, 0], (word >> _BIT_SHIFTS) & 1))
    row = np.repeat(np.where(bits, white, black), CELL_PX).astype(image.dtype)
    _cell_area(image)[:] = row[None, :, None] if image.ndim == 3 else row[None, :]


def read_number(image: NDArray[Any]) -> int | None:
    """Return the number that `stamp_number` drew, None where the cells show none or its check fails.

    The image has shape (H, W) or (H, W, channels), at least 544 x 16 pixels, or raises `InvalidValueError`; C
    order.
    """
    _cell_area(image)
    channels = image.shape[2] if image.ndim == 3 else 1
    return read_number_flat(image.reshape(-1), image.shape[1], channels)


def read_number_flat(items: NDArray[Any], width: int, channels: int) -> int | None:
    """Return the number of an image's items in C order, shape (H * W * channels,); see `read_number`.

    The width is at least 544 pixels; of three channels the second is read.
    """
    start = (_MIDDLE * width + _MIDDLE) * channels + (channels > 1)
    step = CELL_PX * channels
    values = items[start : start + CELLS * step : step].tobytes()
    # Black and white differ in their most significant byte. Bytes are enough, and cheaper than arrays for 34.
    cells = values[items.itemsize - 1 :: items.itemsize]
    white, black = cells[0], cells[1]
    if white <= black:
        return None
    word = int(cells[2:].translate(_DIGITS[(white + black) // 2]), 2)
    number, check = word >> CHECK_BITS, word & 0xFF
    return number if check == _check(number) else None
