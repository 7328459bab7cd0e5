"""Points of a depth image with its camera info and colour image: as the view draws them, and in closed form."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.bench import TableRow
from sfglab.lab.experiments.visualisation.live import MemoryCanvas
from sfglab.lab.sources import open_source
from sfglab.lab.workers.picture_flow import image_message
from sfglab.messages import default_message, serialize
from sfglab.spatial.poses import header_msg
from sfglab.view.arrivals import Arrival
from sfglab.view.session import Session
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

POINTS = "a synchronised pair back-projected as in closed form"
TOLERANCE_M = 1e-5  #: Limit of the distance of a point from its closed form, m.

START_NS = 1_700_000_000_000_000_000  #: Time of the first image, ns.
PERIOD_NS = 100_000_000
SIZE = (640, 360)  #: Width and height of an image, pixels.
CAMERA = "go2/camera_front_color"  #: Optical frame of the camera.

_DEPTH = "/local/go2/camera_front/aligned_depth"
_PICTURE = "/local/go2/camera_front/color/image_raw"
_STEP = 4
_MAX_M = 10.0


Points = tuple["NDArray[np.float64]", "NDArray[np.uint8]"]
"""Points in the camera's optical frame, m, and their colours, both of shape (N, 3)."""

NO_POINTS: Points = (np.zeros((0, 3)), np.zeros((0, 3), np.uint8))


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """A colour image and a depth image of one time."""

    number: int  #: Number of the moment, from 0.
    rgb: NDArray[np.uint8]  #: Colour image, shape (H, W, 3), RGB.
    #: Depth registered to the colour image, shape (H, W), mm; 0 where unknown.
    depth_mm: NDArray[np.uint16]

    @property
    def stamp_ns(self) -> int:
        """Time of the capture, ns."""
        return START_NS + self.number * PERIOD_NS

    def header(self, frame: str) -> Any:
        """Return a message header with the time of this moment and a frame."""
        return header_msg(frame, self.stamp_ns)


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationCloudRow(TableRow):
    """The drawn points of one depth image, compared with their closed form."""

    points: int  #: Number of drawn points.
    #: Largest distance between a point and its closed form, m; infinite if points are missing or have other
    #: colours.
    largest_error_m: float


def scene_moments(count: int, seed: int) -> Iterator[Moment]:
    """Yield images with depth of a camera that moves over a scene (scikit-image's stereo pair)."""
    with closing(open_source("stereo", width=SIZE[0], height=SIZE[1], seed=seed)) as source:
        for number in range(count):
            frame = source.frame()
            assert frame.depth_mm is not None
            rgb = np.ascontiguousarray(frame.bgr[..., ::-1])
            yield Moment(number=number, rgb=rgb, depth_mm=frame.depth_mm)


def camera_info(header: Any, size: tuple[int, int]) -> Any:
    """Return a ``CameraInfo`` of a rectified camera, width and height given, with a focal length of 0.72 widths."""
    width, height = size
    focal = 0.72 * width
    k = np.array([focal, 0, width / 2 - 0.5, 0, focal, height / 2 - 0.5, 0, 0, 1])
    type_name = "sensor_msgs/msg/CameraInfo"
    return default_message(type_name, header=header, width=width, height=height, k=k)


def shown_points(moments: Sequence[Moment]) -> dict[int, Points]:
    """Show the depth images as points, and return the drawn points by stamp, ns."""
    session = Session()
    canvas = MemoryCanvas()
    topics = {"depth": f"{_DEPTH}/image_raw", "info": f"{_DEPTH}/camera_info", "color": _PICTURE}
    settings = {"decimation": _STEP, "depth_max_m": _MAX_M}
    display = session.add("depth_cloud", topics, settings)
    session.limit(display.id, None)
    replay(chain.from_iterable(map(_arrivals, moments)), session, canvas)
    shown = {}
    for stamp_ns, cloud in canvas.drawn:
        positions = np.array(cloud.positions.as_arrow_array().to_pylist())
        rgba = np.array(cloud.colors.as_arrow_array().to_pylist(), ">u4")
        shown[stamp_ns] = positions, rgba.view(np.uint8).reshape(-1, 4)[:, :3]
    return shown


def _arrivals(moment: Moment) -> Iterator[Arrival]:
    """Yield the messages of a moment."""
    header = moment.header(CAMERA)
    messages = [
        (f"{_DEPTH}/camera_info", camera_info(header, SIZE)),
        (_PICTURE, image_message(moment.rgb, "rgb8", header)),
        (f"{_DEPTH}/image_raw", image_message(moment.depth_mm, "16UC1", header)),
    ]
    for topic, message in messages:
        yield Arrival(topic, message.__msgtype__, moment.stamp_ns, serialize(message))


def back_projected(moment: Moment, info: Any, *, step: int, max_m: float) -> Points:
    """Return the points of a depth image: depth times the inverse intrinsics times the pixel.

    Args:
        moment: Depth image and colour image of one time.
        info: Its ``CameraInfo``.
        step: Step between the rows and columns that are used.
        max_m: Largest depth, m.
    """
    inverse = np.linalg.inv(np.asarray(info.k, dtype=np.float64).reshape(3, 3))
    height, width = moment.depth_mm.shape
    v, u = np.meshgrid(np.arange(0, height, step), np.arange(0, width, step), indexing="ij")
    z = moment.depth_mm[v, u] / 1000.0
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse.T
    seen = (z > 0) & (z <= max_m)
    return (rays * z[..., None])[seen], moment.rgb[v, u][seen]


def compared(moment: Moment, shown: Points) -> VisualisationCloudRow:
    """Compare the points of a depth image with their closed form."""
    info = camera_info(moment.header(CAMERA), SIZE)
    expected, expected_colors = back_projected(moment, info, step=_STEP, max_m=_MAX_M)
    points, colors = shown
    largest_m = np.inf
    if len(points) and np.array_equal(colors, expected_colors):
        largest_m = float(np.linalg.norm(points - expected, axis=1).max())
    return VisualisationCloudRow(points=len(points), largest_error_m=largest_m)
