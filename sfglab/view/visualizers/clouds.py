"""Visualizers of points in space: depth images with their camera info, point clouds, and laser scans."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sfglab.codecs import COMPRESSED_IMAGE, decode_depth, parse_depth_format
from sfglab.errors import InvalidValueError
from sfglab.qos import LATCHED, SENSOR_DATA
from sfglab.view import geometry
from sfglab.view.rerunning import rr
from sfglab.view.sync import Approximate, SyncPolicy
from sfglab.view.visualizer import Canvas, Input, Parameter, Update, Visualizer

if TYPE_CHECKING:
    from numpy.typing import NDArray


_RADIUS = Parameter(
    "radius_m", 0.0, "radius of a point, m; 0: the same on the screen", minimum=0, maximum=1.0
)
#: A negative radius is in pixels of the screen, at any distance (Rerun).
_SCREEN_RADIUS = -1.5

_INFO_QOS = replace(LATCHED, depth=SENSOR_DATA.depth)
_INFO = Input(
    "info", "sensor_msgs/msg/CameraInfo", sibling="camera_info", steady=True, qos=_INFO_QOS
)
_COLOR = Input("color", "sensor_msgs/msg/Image", optional=True)


class _DepthPoints(Visualizer):
    """Coloured points of a depth image, from its camera info and, if bound, an image registered to it."""

    sync: ClassVar[SyncPolicy] = Approximate(slop_ns=20_000_000)
    max_hz = 15.0
    parameters = (
        _RADIUS,
        Parameter("decimation", 4, "take every n-th row and column", minimum=1, maximum=64),
        Parameter("depth_max_m", 10.0, "leave out what is farther, m", minimum=0.1, maximum=1000.0),
    )

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the points."""
        color, info = update.messages.get("color"), update["info"]
        frame = update["depth"].header.frame_id
        depth = self._depth(update["depth"])
        _check_camera(frame, depth.shape, info)
        points, colors = geometry.depth_points(
            depth,
            geometry.pinhole_matrix(info),
            decimation=self["decimation"],
            color=None if color is None else _rgb(color),
            max_m=self["depth_max_m"],
        )
        if colors is None:
            colors = geometry.colors_by_value(points[:, 2])
        canvas.place(f"{self.entity}/cloud", frame)
        canvas.log(f"{self.entity}/cloud", _points(points, colors, self))

    def _depth(self, message: Any) -> NDArray[Any]:
        raise NotImplementedError


def _check_camera(frame: str, shape: tuple[int, ...], info: Any) -> None:
    """Check that a camera info is for this camera and image size.

    Raises:
        InvalidValueError: The camera info is for another frame, or for another size.
    """
    if frame and info.header.frame_id and info.header.frame_id != frame:
        raise InvalidValueError("camera info, frame", info.header.frame_id, repr(frame))
    size = (info.height, info.width)
    if any(size) and size != shape:
        raise InvalidValueError(
            "camera info, size", f"{size[1]} x {size[0]}", f"{shape[1]} x {shape[0]}"
        )


class DepthCloud(_DepthPoints):
    """Points of a raw depth image (``sensor_msgs/msg/Image``)."""

    name = "depth_cloud"
    inputs = (Input("depth", "sensor_msgs/msg/Image", pattern="*depth*"), _INFO, _COLOR)

    def _depth(self, message: Any) -> NDArray[Any]:
        if message.encoding not in ("16UC1", "mono16", "32FC1"):
            raise InvalidValueError("depth encoding", message.encoding, "16UC1, mono16, 32FC1")
        return geometry.pixels(message)


class CompressedDepthCloud(_DepthPoints):
    """Points of a compressed depth image (``sensor_msgs/msg/CompressedImage`` in RVL or PNG)."""

    name = "compressed_depth_cloud"
    inputs = (Input("depth", COMPRESSED_IMAGE, pattern="*depth*"), _INFO, _COLOR)

    def _depth(self, message: Any) -> NDArray[Any]:
        return decode_depth(bytes(message.data), parse_depth_format(message.format))[0]


class PointCloud(Visualizer):
    """Points of a ``PointCloud2``, coloured by the field ``rgb`` or by the values of another field."""

    name = "point_cloud"
    inputs = (Input("cloud", "sensor_msgs/msg/PointCloud2"),)
    max_hz = 15.0
    parameters = (
        _RADIUS,
        Parameter("decimation", 1, "take every n-th point", minimum=1, maximum=1000),
        Parameter("color_by", "", "field that colours the points; empty: rgb, intensity or z"),
    )

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the points."""
        points, records = geometry.cloud_points(update.only)
        step = self["decimation"]
        points, records = points[::step], records[::step]
        canvas.place(self.entity, update.only.header.frame_id)
        canvas.log(self.entity, _points(points, self._colors(records), self))

    def _colors(self, records: NDArray[Any]) -> NDArray[np.uint8]:
        names, field = records.dtype.names or (), self["color_by"]
        if field and field not in names:
            raise InvalidValueError("color_by", field, f"the fields {', '.join(names)}")
        if field in ("", "rgb", "rgba"):
            colors = geometry.cloud_colors(records)
            if colors is not None:
                return colors
            field = field or ("intensity" if "intensity" in names else "z")
        return geometry.colors_by_value(records[field])


class LaserScan(Visualizer):
    """Points of a ``LaserScan``."""

    name = "laser_scan"
    inputs = (Input("scan", "sensor_msgs/msg/LaserScan"),)
    parameters = (_RADIUS,)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the points, coloured by their distance."""
        scan = update.only
        points = geometry.scan_points(scan)
        colors = geometry.colors_by_value(np.hypot(points[:, 0], points[:, 1]))
        canvas.place(self.entity, scan.header.frame_id)
        canvas.log(self.entity, _points(points, colors, self))


def _points(points: NDArray[Any], colors: NDArray[np.uint8], of: Visualizer) -> Any:
    return rr.Points3D(points, colors=colors, radii=of["radius_m"] or _SCREEN_RADIUS)


def _rgb(image: Any) -> NDArray[np.uint8]:
    array = geometry.pixels(image)
    if array.ndim == 2:
        return array[:, :, None].repeat(3, axis=2)
    return array[:, :, 2::-1] if image.encoding in ("bgr8", "bgra8", "8UC3") else array[:, :, :3]
