"""Depth in our own format: bytes worked out by hand, and a plain decoder beside the fast one."""

import struct

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage import data

from sfglab.codecs import BitstreamError
from sfglab.codecs.med import decode, encode
from sfglab.codecs.rvl import encode as encode_rvl

IMAGES = st.tuples(st.integers(1, 9), st.integers(1, 40))


def plainly(frame: bytes, rows: int, columns: int) -> list[list[int]]:
    """Decode as the module's docstring says it, by Zstandard's own library and plain loops."""
    content = zstandard.ZstdDecompressor().decompress(frame)
    codes, values = (
        iter(content[: rows * columns]),
        iter(struct.iter_unpack("<H", content[rows * columns :])),
    )
    above, image = [1] * columns, []
    for _ in range(rows):
        left = corner = above[0]
        image.append([])
        for x, up in enumerate(above):
            guess = sorted((left, up, left + up - corner))[1]
            code = next(codes)
            if code:
                change = (code - 1) // 2 if code % 2 else -(code // 2)
                left = next(values)[0] if code == 255 else guess + change
            image[-1].append(left if code else 0)
            corner, above[x] = up, left
    return image


def packed(codes: list[int], *values: int) -> bytes:
    return zstandard.compress(bytes(codes) + struct.pack(f"<{len(values)}H", *values))


def test_holes_steps_and_far_values_are_the_bytes_worked_out_by_hand():
    frame = encode(np.array([[0, 0, 5, 6, 6], [900, 0, 7, 6, 4]], "u2"))
    content = zstandard.ZstdDecompressor().decompress(frame)
    # 900 follows; below it the hole goes on as 900, so that 7 is guessed from 900, 5 and 1
    # to be 900; then 6 from 7, 6 and 5 to be 7, and 4 from 6, 6 and 6.
    assert content.hex(" ") == "00 00 09 03 01 ff 00 ff 02 04 84 03 07 00"


@given(
    hnp.arrays(
        np.uint16, IMAGES, elements=st.integers(0, 65535) | st.integers(0, 3) | st.just(65535)
    )
)
@settings(max_examples=200, deadline=None)
def test_any_image_comes_back_by_the_fast_and_by_the_plain_decoder(depth):
    frame = encode(depth)
    assert np.array_equal(decode(frame, depth.shape), depth)
    assert plainly(frame, *depth.shape) == depth.tolist()


def test_other_byte_orders_and_strides_are_the_same_image():
    depth = np.arange(60, dtype=np.uint16).reshape(6, 10) * 1000
    assert encode(depth.astype(">u2")) == encode(np.asfortranarray(depth)) == encode(depth)
    assert encode(depth[::2, ::-1]) == encode(depth[::2, ::-1].copy())


def test_measured_depth_is_a_third_smaller_than_by_rvl():
    disparity = data.stereo_motorcycle()[2]
    seen = np.isfinite(disparity)
    depth = (
        np.where(seen, 994.978 * 193.001 / (np.where(seen, disparity, 1) + 31.086), 0)
        .round()
        .astype("u2")
    )
    frame = encode(depth)
    assert np.array_equal(decode(frame, depth.shape), depth)
    assert len(encode_rvl(depth)) > 1.4 * len(frame)


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (b"", "content size"),
        (bytes(12), "content size"),
        (packed([1, 1, 1]), "holds 3 bytes"),
        (packed([1] * 5), "holds 5 bytes"),
        (packed([1] * 4, 1, 2, 3, 4, 5), "holds 14 bytes"),
        (packed([1] * 4) + b"x", "1 bytes"),
        (packed([1] * 4)[:-1], "."),
        (zstandard.ZstdCompressor(write_content_size=False).compress(bytes(4)), "holds -1 bytes"),
        (packed([255, 1, 1, 1]), "more pixels than values"),
        (packed([1, 1, 1, 1], 7), "values are left"),
        (packed([255, 1, 1, 1], 0), "neither a hole"),
        (packed([3, 2, 4, 1]), "neither a hole"),
        (packed([255, 3, 1, 1], 65535), "neither a hole"),
    ],
)
def test_other_bytes_are_refused_with_the_reason(frame, fault):
    with pytest.raises(BitstreamError, match=fault):
        decode(frame, (1, 4))


@pytest.mark.parametrize("shape", [(0, 4), (2**14, 2**14)])
def test_no_pixels_and_too_many_are_refused(shape):
    with pytest.raises(BitstreamError, match="claims"):
        encode(np.broadcast_to(np.uint16(1), shape))
