"""Test input, made here: moving pictures and the H.264 stream of them."""

import numpy as np
import pytest

from sfglab.codecs import TABLE_2, H264Encoder


def moving_picture(index: int) -> np.ndarray:
    """A textured plane that slides by three pixels a frame, and a bright square that runs across it."""
    rows, columns = np.mgrid[0:360, 0:640]
    columns = columns + 3 * index
    waves = (
        128 + 80 * np.sin(columns / 17) * np.cos(rows / 23),
        128 + 60 * np.sin(columns / 7 + rows / 11),
    )
    picture = np.stack([*waves, (columns ^ rows) & 127], axis=-1).astype(np.uint8)
    left = 8 * index % (640 - 32)
    picture[32:64, left : left + 32] = 255
    return picture


@pytest.fixture(scope="session")
def pictures():
    return [moving_picture(index) for index in range(65)]


@pytest.fixture(scope="session")
def stream(pictures):
    encoder = H264Encoder(TABLE_2)
    return [frame for picture in pictures for frame in encoder.encode(picture)]
