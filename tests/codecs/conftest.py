"""Test input, made here: moving pictures and the H.264 stream of them."""

import pytest
from codec_pictures import moving_picture

from sfglab.codecs import TABLE_2, H264Encoder


@pytest.fixture(scope="session")
def pictures():
    return [moving_picture(index) for index in range(65)]


@pytest.fixture(scope="session")
def stream(pictures):
    encoder = H264Encoder(TABLE_2)
    return [frame for picture in pictures for frame in encoder.encode(picture)]
