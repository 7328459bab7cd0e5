"""Moments of the scene: a picture with its depth, a place, a time; and what a camera says of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.sources import open_source
from sfglab.messages import default_message, message_type, stamp_from_ns

if TYPE_CHECKING:
    from numpy.typing import NDArray


START_NS = 1_700_000_000_000_000_000
"""The first moment; any time will do, this one is easily recognised."""

PERIOD_NS = 100_000_000
RECEIVED_AFTER_NS = 2_000_000
"""How long after its stamp a message is in the log."""

SIZE = (640, 360)
"""Width and height of a moment's picture."""

CAMERA = "go2/camera_front_color"


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """What the fleet looks like at one time."""

    number: int  #: Counter from 0.
    rgb: NDArray[np.uint8]  #: A picture, shape (H, W, 3).
    depth_mm: NDArray[np.uint16]  #: Depth registered to it, shape (H, W).

    @property
    def stamp_ns(self) -> int:
        """When everything was captured."""
        return START_NS + self.number * PERIOD_NS

    def header(self, frame: str) -> Any:
        """Return a header of this moment."""
        return message_type("std_msgs/msg/Header")(stamp=stamp_from_ns(self.stamp_ns), frame_id=frame)

    @property
    def place(self) -> NDArray[np.float64]:
        """Where the robot is, metres, exact in binary so that it survives every representation."""
        return np.array([self.number / 8, 1 - self.number / 16, 0.25])

    def halved(self) -> Moment:
        """Return the same with every second pixel of every second row."""
        picture, depth = self.rgb[::2, ::2], self.depth_mm[::2, ::2]
        return replace(self, rgb=np.ascontiguousarray(picture), depth_mm=np.ascontiguousarray(depth))


def scene_moments(count: int, seed: int) -> list[Moment]:
    """Return pictures with measured depth, as a camera would see them that wanders over a scene.

    Args:
        count: How many.
        seed: Of the camera's way.
    """
    source = open_source("stereo", width=SIZE[0], height=SIZE[1], seed=seed)
    found = []
    for number in range(count):
        frame = source.frame()
        assert frame.depth_mm is not None
        rgb = np.ascontiguousarray(frame.bgr[..., ::-1])
        found.append(Moment(number=number, rgb=rgb, depth_mm=frame.depth_mm))
    source.close()
    return found


def image_message(array: NDArray[Any], encoding: str, header: Any) -> Any:
    """Return an ``Image``."""
    return message_type("sensor_msgs/msg/Image")(
        header=header,
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=array[0].nbytes,
        data=np.ascontiguousarray(array).reshape(-1).view(np.uint8),
    )


def camera_info(header: Any, size: tuple[int, int]) -> Any:
    """Return a ``CameraInfo`` of a rectified camera with a focal length of 0.72 widths."""
    info = default_message("sensor_msgs/msg/CameraInfo")
    info.header, (info.width, info.height) = header, size
    focal = 0.72 * size[0]
    info.k = np.array([focal, 0, size[0] / 2 - 0.5, 0, focal, size[1] / 2 - 0.5, 0, 0, 1])
    return info


def back_projected(depth_mm: NDArray[Any], info: Any, *, step: int, max_m: float) -> NDArray[np.float64]:
    """Return the points of a depth image by its inverse intrinsics, in double precision, row by row.

    Args:
        depth_mm: Shape (H, W), 0 where unknown.
        info: Its ``CameraInfo``.
        step: Every how many-th row and column is taken.
        max_m: Depth beyond which pixels are left out.
    """
    inverse = np.linalg.inv(np.asarray(info.k, dtype=np.float64).reshape(3, 3))
    height, width = depth_mm.shape
    v, u = np.meshgrid(np.arange(0, height, step), np.arange(0, width, step), indexing="ij")
    z = depth_mm[v, u] / 1000.0
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse.T
    return np.asarray((rays * z[..., None])[(z > 0) & (z <= max_m)])
