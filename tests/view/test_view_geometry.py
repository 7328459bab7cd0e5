"""From messages to points and pixels: known numbers, round trips, and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seen import cloud

from sfglab.errors import InvalidValueError
from sfglab.messages import default_message
from sfglab.view import geometry

K = np.array([[500.0, 0, 320], [0, 400.0, 180], [0, 0, 1]])
XYZ = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
rng = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [("rgb8", "3u1"), ("bgra8", "4u1"), ("mono8", "u1"), ("16UC1", "u2"), ("32FC1", "f4")],
)
@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("is_swapped", [False, True])
def test_pixels_are_what_was_sent_whatever_the_padding_and_byte_order(
    make_image, encoding, pixel, padding, is_swapped
):
    pixel = np.dtype(pixel)
    array = rng.integers(0, 255, (4, 5, *pixel.shape)).astype(pixel.base)
    message = make_image(array.byteswap() if is_swapped else array, encoding, padding=padding)
    message.is_bigendian = is_swapped
    found = geometry.pixels(message)
    assert np.array_equal(found, array)
    assert np.shares_memory(found, message.data) == (
        not padding and (not is_swapped or pixel.base.itemsize == 1)
    )


def test_an_image_that_contradicts_itself_is_refused(make_image):
    message = make_image(np.zeros((4, 5), np.uint8), "mono8")
    message.height = 400
    said = "image data: given '20 bytes with step 5', allowed: at least 400 rows"
    with pytest.raises(InvalidValueError, match=said):
        geometry.pixels(message)
    message.encoding = "yuv9"
    with pytest.raises(InvalidValueError, match="image encoding: given 'yuv9', allowed: mono8"):
        geometry.pixels(message)


@given(st.integers(1, 7), st.integers(0, 2**31))
def test_points_of_a_depth_image_project_back_to_their_pixels(decimation, seed):
    depth = np.random.default_rng(seed).integers(0, 9000, (30, 41)).astype(np.uint16)
    points, _ = geometry.depth_points(depth, K, decimation=decimation, max_m=8.0)
    u, v, _ = K @ (points / points[:, 2:]).T
    columns, rows = u.round().astype(int), v.round().astype(int)
    assert np.allclose([u, v], [columns, rows], atol=1e-2)
    assert np.allclose(points[:, 2], depth[rows, columns] / 1000)
    wanted = depth[::decimation, ::decimation]
    assert len(points) == ((wanted > 0) & (wanted <= 8000)).sum()


def test_points_take_the_colour_of_their_pixel_also_from_a_picture_of_another_size():
    depth = np.full((4, 6), 2.0, np.float32)
    depth[1, 2] = np.nan
    color = rng.integers(0, 255, (8, 12, 3)).astype(np.uint8)
    _, colors = geometry.depth_points(depth, K, color=color)
    rows, columns = np.nonzero(np.isfinite(depth))
    assert np.array_equal(colors, color[2 * rows, 2 * columns])


def test_the_rectified_matrix_is_p_and_k_only_without_it():
    info = default_message("sensor_msgs/msg/CameraInfo", k=K.reshape(-1))
    assert np.array_equal(geometry.pinhole_matrix(info), K)
    info.p = np.hstack([2 * K, np.zeros((3, 1))]).reshape(-1)
    assert np.array_equal(geometry.pinhole_matrix(info), 2 * K)
    info.p, info.k = np.zeros(12), np.zeros(9)
    with pytest.raises(InvalidValueError, match="positive focal lengths"):
        geometry.pinhole_matrix(info)


def test_a_scan_is_points_on_its_rays_and_its_range_limits_hold():
    scan = default_message("sensor_msgs/msg/LaserScan", angle_increment=np.pi / 2)
    scan.range_min, scan.range_max = 0.1, 10.0
    scan.ranges = np.array([1, 2, np.inf, 0.05, np.nan, 11, 3], np.float32)
    assert np.allclose(geometry.scan_points(scan), [[1, 0, 0], [0, 2, 0], [-3, 0, 0]], atol=1e-5)


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
    records["x"], records["ring"] = range(10), range(10)
    records["rgb"] = np.full(10, 0x102030, f"{order}u4").view(order + packed)
    records["z"][3] = np.nan
    points, kept = geometry.cloud_points(cloud(records, row_step=row_step, height=2))
    assert np.array_equal(points[:, 0], [0, 1, 2, 4, 5, 6, 7, 8, 9])
    assert np.array_equal(kept["ring"], points[:, 0])
    assert np.array_equal(geometry.cloud_colors(kept), [[0x10, 0x20, 0x30]] * 9)


def test_colours_run_from_blue_to_red():
    (first, _, last, _) = geometry.colors_by_value(np.array([0.0, 1.0, 2.0, np.nan]))
    assert first[2] > first[0]
    assert last[0] > last[2]
    assert geometry.colors_by_value(np.zeros(0)).shape == (0, 3)
    assert geometry.colors_by_value(np.ones(3)).shape == (3, 3)


def test_a_cloud_without_coordinates_or_with_too_little_data_is_refused():
    said = "point cloud, fields: given 'x, y', allowed: x, y, z"
    with pytest.raises(InvalidValueError, match=said):
        geometry.cloud_points(cloud(np.zeros(4, XYZ[:2])))
    message = cloud(np.zeros(4, XYZ))
    message.data = message.data[:-1]
    with pytest.raises(InvalidValueError, match="point cloud data"):
        geometry.cloud_points(message)
