"""A number drawn into a frame is read back, also through H.264, and never read wrongly from noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.lab.framenumber import CELL_PX, CELLS, read_number, stamp_number


@given(st.integers(0, 2**24 - 1))
def test_every_number_is_read_back_from_colour_and_depth(number):
    colour = np.full((360, 640, 3), 90, dtype=np.uint8)
    stamp_number(colour, number)
    assert read_number(colour) == number
    depth = np.full((360, 640), 2000, dtype=np.uint16)
    stamp_number(depth, number, white=4000, black=1000)
    assert read_number(depth) == number


def test_only_the_cells_are_touched():
    image = np.full((360, 640, 3), 90, dtype=np.uint8)
    stamp_number(image, 7)
    assert (image[CELL_PX:] == 90).all()
    assert (image[:, CELLS * CELL_PX :] == 90).all()


def test_an_unmarked_or_noisy_image_shows_no_number():
    assert read_number(np.zeros((360, 640, 3), dtype=np.uint8)) is None
    rng = np.random.default_rng(1)
    reads = [read_number(rng.integers(0, 255, (16, 640, 3), dtype=np.uint8)) for _ in range(200)]
    assert sum(r is not None for r in reads) <= 5  # an 8-bit check lets 1 of 256 through


@pytest.mark.parametrize("flip", range(2, CELLS))
def test_one_wrong_cell_is_noticed(flip):
    image = np.zeros((16, CELLS * CELL_PX), dtype=np.uint8)
    stamp_number(image, 123456)
    cell = image[:, flip * CELL_PX : (flip + 1) * CELL_PX]
    cell[:] = 251 - cell
    assert read_number(image) is None


def test_a_frame_too_small_and_a_number_too_large_are_refused_with_the_bounds():
    with pytest.raises(InvalidValueError, match="at least 544 x 16"):
        read_number(np.zeros((16, 100), dtype=np.uint8))
    with pytest.raises(InvalidValueError, match="16777215"):
        stamp_number(np.zeros((16, 640), dtype=np.uint8), 2**24)
