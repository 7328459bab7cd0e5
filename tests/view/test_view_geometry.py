"""Points and pixels of messages, for each layout of their bytes."""

import numpy as np
import pytest
from seen import cloud

from sfglab.lab.workers.picture_flow import image_message
from sfglab.view import geometry

rng = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [("rgb8", "3u1"), ("bgra8", "4u1"), ("mono8", "u1"), ("16UC1", "u2"), ("32FC1", "f4")],
)
@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("is_swapped", [False, True])
def test_pixels_are_what_was_sent_whatever_the_padding_and_byte_order(
    encoding, pixel, padding, is_swapped
):
    pixel = np.dtype(pixel)
    array = rng.integers(0, 255, (4, 5, *pixel.shape)).astype(pixel.base)
    message = image_message(array.byteswap() if is_swapped else array, encoding, None)
    rows = message.data.reshape(message.height, -1)
    message.data = np.pad(rows, ((0, 0), (0, padding))).reshape(-1)
    message.step += padding
    message.is_bigendian = is_swapped
    found = geometry.pixels(message)
    assert np.array_equal(found, array)
    if not padding and not is_swapped:
        assert np.shares_memory(found, message.data), "nothing is copied"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("row_step", [None, 200, 0])
@pytest.mark.parametrize("packed", ["u4", "f4"])
def test_a_cloud_gives_its_finite_points_with_their_fields_and_colours(order, row_step, packed):
    layout = {
        "names": ["x", "y", "z", "ring", "rgb"],
        "formats": [f"{order}f4"] * 3 + [f"{order}u2", order + packed],
        "offsets": [0, 4, 8, 14, 16],
        "itemsize": 24,
    }
    records = np.zeros(10, np.dtype(layout))
    records["x"] = records["ring"] = range(10)
    records["rgb"] = np.full(10, 0x102030, f"{order}u4").view(order + packed)
    records["z"][3] = np.nan
    points, kept = geometry.cloud_points(cloud(records, row_step=row_step, height=2))
    assert np.array_equal(points[:, 0], [0, 1, 2, 4, 5, 6, 7, 8, 9])
    assert np.array_equal(kept["ring"], points[:, 0])
    assert np.array_equal(geometry.cloud_colors(kept), [[0x10, 0x20, 0x30]] * 9)
