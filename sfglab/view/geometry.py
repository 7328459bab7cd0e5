"""Points and pixels of sensor messages as arrays.

The functions have no side effects and do not depend on the viewer; they read messages by their attributes. Points are
in the frame of the message's header, in metres, float32, shape (N, 3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PIXELS = {
    "mono8": "u1",
    "8UC1": "u1",
    "mono16": "u2",
    "16UC1": "u2",
    "32FC1": "f4",
    "rgb8": "3u1",
    "bgr8": "3u1",
    "8UC3": "3u1",
    "rgba8": "4u1",
    "bgra8": "4u1",
}
"""NumPy's type of a pixel by the names of sensor_msgs/image_encodings.hpp."""

_POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the numbers in sensor_msgs/msg/PointField."""


def pixels(image: Any) -> NDArray[Any]:
    """Return the pixels of a ``sensor_msgs/msg/Image``, without its padding and in this machine's byte order.

    The result has the shape (height, width) or (height, width, channels) and the type of the encoding. It is a view of
    the message's data if possible.

    Raises:
        InvalidValueError: The encoding is unknown, or the image's size does not fit its data.
    """
    if image.encoding not in _PIXELS:
        raise InvalidValueError("image encoding", image.encoding, ", ".join(_PIXELS))
    pixel = np.dtype(_PIXELS[image.encoding])
    row_bytes = image.width * pixel.itemsize
    step = image.step or row_bytes
    if step < row_bytes or len(image.data) < step * image.height:
        given = f"{len(image.data)} bytes with step {image.step}"
        needed = f"at least {image.height} rows of {row_bytes} bytes"
        raise InvalidValueError("image data", given, needed)
    rows = np.asarray(image.data[: step * image.height]).reshape(image.height, step)
    sent = pixel.base.newbyteorder(">" if image.is_bigendian else "<")
    array = np.ascontiguousarray(rows[:, :row_bytes]).view(sent)
    return array.astype(pixel.base, copy=False).reshape(image.height, image.width, *pixel.shape)


def depth_in_m(depth: NDArray[Any]) -> NDArray[np.float32]:
    """Return a depth image in metres with NaN for holes, in the same shape.

    An image of uint16 has millimetres with 0 for holes, one of float32 has metres already (REP 118).
    """
    if depth.dtype == np.uint16:
        metres = depth.astype(np.float32) * np.float32(1e-3)
        metres[depth == 0] = np.nan
        return metres
    return depth.astype(np.float32, copy=False)


def pinhole_matrix(info: Any) -> NDArray[np.float64]:
    """Return the 3 x 3 matrix of a ``sensor_msgs/msg/CameraInfo`` for a rectified image.

    It is the left part of P if P is given, otherwise K; distortion is not applied.

    Raises:
        InvalidValueError: Neither P nor K has positive focal lengths.
    """
    matrix = np.asarray(info.p, dtype=np.float64).reshape(3, 4)[:, :3]
    if not matrix[0, 0] > 0:
        matrix = np.asarray(info.k, dtype=np.float64).reshape(3, 3)
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise InvalidValueError("camera info, K", matrix.tolist(), "positive focal lengths")
    return matrix


def depth_points(
    depth: NDArray[Any],
    matrix: NDArray[np.float64],
    *,
    decimation: int = 1,
    color: NDArray[np.uint8] | None = None,
    max_m: float = np.inf,
) -> tuple[NDArray[np.float32], NDArray[np.uint8] | None]:
    """Return the points of a depth image: x = (u - cx) z / fx, y = (v - cy) z / fy, z.

    Args:
        depth: Shape (rows, columns), uint16 millimetres or float32 metres.
        matrix: Pinhole matrix of the image at its full size.
        decimation: Step between the rows and columns that are used.
        color: RGB image, registered to the depth image; an image of another size is sampled.
        max_m: Depth beyond which pixels are left out, metres.

    Returns:
        Points in the camera's optical frame (z forward, REP 103), and their colours, shape (N, 3) each; None for the
        colours without `color`.
    """
    z = depth_in_m(depth[::decimation, ::decimation])
    rows, columns = np.nonzero((z > 0) & (z <= max_m))
    distance = z[rows, columns]
    u, v = (columns * decimation).astype(np.float32), (rows * decimation).astype(np.float32)
    fx, fy, cx, cy = matrix[[0, 1, 0, 1], [0, 1, 2, 2]].astype(np.float32)
    points = np.column_stack([(u - cx) * distance / fx, (v - cy) * distance / fy, distance])
    if color is None:
        return points, None
    scale_v, scale_u = color.shape[0] / depth.shape[0], color.shape[1] / depth.shape[1]
    return points, color[(v * scale_v).astype(int), (u * scale_u).astype(int), :3]


def scan_points(scan: Any) -> NDArray[np.float32]:
    """Return the points of a ``sensor_msgs/msg/LaserScan`` in its frame, m, shape (N, 3), with z = 0.

    Ranges beyond the message's own limits are left out.
    """
    ranges = np.asarray(scan.ranges, dtype=np.float32)
    angles = scan.angle_min + np.arange(len(ranges)) * scan.angle_increment
    hit = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
    distance, angle = ranges[hit], angles[hit]
    points = [distance * np.cos(angle), distance * np.sin(angle), np.zeros(len(distance))]
    return np.column_stack(points).astype(np.float32)


def cloud_points(cloud: Any) -> tuple[NDArray[np.float32], NDArray[Any]]:
    """Return the finite points of a ``sensor_msgs/msg/PointCloud2``, and a structured array of all their fields.

    The points are in the cloud's frame, m, shape (N, 3); the structured array has shape (N,).

    Raises:
        InvalidValueError: The cloud does not have the fields x, y and z, or its sizes do not fit its data.
    """
    records = _records(cloud)
    names = records.dtype.names or ()
    if not {"x", "y", "z"}.issubset(names):
        given = ", ".join(names) or "none"
        raise InvalidValueError("point cloud, fields", given, "x, y, z among others")
    points = np.column_stack([records[axis].astype(np.float32) for axis in "xyz"])
    finite = np.isfinite(points).all(axis=1)
    return points[finite], records[finite]


def cloud_colors(records: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Return the colours of a cloud's points, shape (N, 3), uint8, RGB; None without a field for them.

    The field ``rgb`` or ``rgba`` has the bits 0xAARRGGBB, as in PCL.
    """
    for name in ("rgb", "rgba"):
        if name in (records.dtype.names or ()) and records.dtype[name].itemsize == 4:
            packed = np.ascontiguousarray(records[name])
            bits = packed.view(packed.dtype.str[0] + "u4").astype("<u4")
            return bits.view(np.uint8).reshape(-1, 4)[:, 2::-1]
    return None


def colors_by_value(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return RGB colours from blue to red between the values' 1st and 99th percentile, shape (N, 3)."""
    import cv2

    values = np.asarray(values, dtype=np.float32)
    if not len(values):
        return np.zeros((0, 3), np.uint8)
    low, high = np.nanpercentile(values, [1, 99])
    share = np.clip((values - low) / max(high - low, 1e-9), 0, 1)
    levels = (np.nan_to_num(share) * 255).astype(np.uint8).reshape(-1, 1)
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO)[:, 0, ::-1])


def _records(cloud: Any) -> NDArray[Any]:
    """Return all points with their fields; a row step of 0 means rows without padding."""
    order = ">" if cloud.is_bigendian else "<"
    fields = [f for f in cloud.fields if f.datatype in _POINT_TYPES and f.count <= 1]
    row_bytes = cloud.width * cloud.point_step
    row_step = cloud.row_step or row_bytes
    layout: Any = {
        "names": [field.name for field in fields],
        "formats": [order + _POINT_TYPES[field.datatype] for field in fields],
        "offsets": [field.offset for field in fields],
        "itemsize": cloud.point_step,
    }
    try:
        dtype = np.dtype(layout)
        rows = np.asarray(cloud.data)[: row_step * cloud.height].reshape(cloud.height, row_step)
        return np.ascontiguousarray(rows[:, :row_bytes]).reshape(-1).view(dtype)
    except ValueError as error:
        given = f"{len(cloud.data)} bytes as {cloud.height} rows of {row_step}"
        needed = f"what fits its fields ({error})"
        raise InvalidValueError("point cloud data", given, needed) from error
