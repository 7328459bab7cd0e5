"""Pictures with measured depth as a camera of a robot would send them, and their points in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.sources import open_source
from sfglab.messages import default_message, message_type
from sfglab.spatial.poses import header_msg

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: The first moment; any time will do, this one is easily recognised.
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
SIZE = (640, 360)  #: Width and height of a picture.
CAMERA = "go2/camera_front_color"  #: Optical frame of the camera.


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A picture and its depth at one time."""

    number: int  #: Counter from 0.
    rgb: NDArray[np.uint8]  #: Picture, shape (H, W, 3).
    depth_mm: NDArray[np.uint16]  #: Depth registered to it, shape (H, W); 0 where unknown.

    @property
    def stamp_ns(self) -> int:
        """Time of the capture."""
        return START_NS + self.number * PERIOD_NS

    def header(self, frame: str) -> Any:
        """Return a header of this moment."""
        return header_msg(frame, self.stamp_ns)

    @property
    def bgr(self) -> NDArray[np.uint8]:
        """The picture as encoders take it."""
        return np.ascontiguousarray(self.rgb[..., ::-1])


def scene_moments(count: int, seed: int) -> list[Moment]:
    """Return pictures with measured depth of a camera that wanders over a scene (scikit-image's stereo pair)."""
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
    """Return an ``Image`` of pixels, shape (H, W) or (H, W, channels)."""
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
    """Return a ``CameraInfo`` of a rectified camera, width and height given, with a focal length of 0.72 widths."""
    width, height = size
    focal = 0.72 * width
    k = np.array([focal, 0, width / 2 - 0.5, 0, focal, height / 2 - 0.5, 0, 0, 1])
    type_name = "sensor_msgs/msg/CameraInfo"
    return default_message(type_name, header=header, width=width, height=height, k=k)


def back_projected(
    depth_mm: NDArray[Any], info: Any, *, step: int, max_m: float
) -> NDArray[np.float64]:
    """Return the points of a depth image in closed form: depth times the inverse intrinsics times the pixel.

    Args:
        depth_mm: Depth, mm, shape (H, W); 0 where unknown.
        info: Its ``CameraInfo``.
        step: Every how many-th row and column is taken.
        max_m: Largest depth, m.

    Returns:
        Points in the camera's optical frame, m, shape (N, 3), in double precision, row by row.
    """
    inverse = np.linalg.inv(np.asarray(info.k, dtype=np.float64).reshape(3, 3))
    height, width = depth_mm.shape
    v, u = np.meshgrid(np.arange(0, height, step), np.arange(0, width, step), indexing="ij")
    z = depth_mm[v, u] / 1000.0
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse.T
    return np.asarray((rays * z[..., None])[(z > 0) & (z <= max_m)])
