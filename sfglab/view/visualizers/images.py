"""Pictures: raw, compressed still, and compressed depth.

A picture lies in the image plane of its camera, a frame of its own below the camera's optical frame, so that it
hangs in space where a camera info says how (`CameraModel`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.codecs import COMPRESSED_IMAGE, decode_depth, parse_depth_format
from sfglab.qos import LATCHED
from sfglab.view.errors import ContentError
from sfglab.view.geometry import DEPTH_ENCODINGS, pinhole_matrix, pixels
from sfglab.view.parameters import Parameter
from sfglab.view.sdk import rerun
from sfglab.view.visualizer import Canvas, Input, Update, Visualizer

if TYPE_CHECKING:
    from numpy.typing import NDArray


_OPACITY = Parameter(
    name="opacity", default=1.0, minimum=0.0, maximum=1.0, help="1 hides what is behind the picture"
)
_DEPTH_RANGE = Parameter(
    name="depth_max_m", default=10.0, minimum=0.1, maximum=1000.0, help="depth that has the last colour, m"
)
_MODELS = {"rgb8": "RGB", "bgr8": "BGR", "8UC3": "BGR", "rgba8": "RGBA", "bgra8": "BGRA"}


def image_plane(frame: str, topic: str) -> str:
    """Return the frame of the pictures of one stream; empty for no frame.

    Streams of one camera may share its optical frame and not its intrinsics, so a picture and a camera info
    belong together by their topics' common name: ``<name>/camera_info`` with ``<name>/ffmpeg`` as the schema
    has it, or with ``<name>/image_raw`` and ``<name>/image_raw/compressed`` as image_transport has it.

    Args:
        frame: The camera's optical frame.
        topic: Of the picture or of the camera info.
    """
    name = topic.rpartition("/")[0]
    parent, _, last = name.rpartition("/")
    name = parent if last.startswith("image") else name
    return f"{frame}/image_plane{name}" if frame else ""


class Image(Visualizer):
    """Raw pictures, and depth by its encoding."""

    name = "image"
    inputs = (Input(role="image", type="sensor_msgs/msg/Image"),)
    parameters = (_OPACITY, _DEPTH_RANGE)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw one picture."""
        message = update.only
        canvas.place(self.entity, image_plane(message.header.frame_id, self.topics["image"]))
        array = pixels(message)
        if message.encoding in ("16UC1", "32FC1"):
            canvas.log(self.entity, _depth(array, message.encoding, self["depth_max_m"]))
            return
        rr = rerun()
        model = _MODELS.get(message.encoding, "L")
        canvas.log(self.entity, rr.Image(array, model, opacity=self["opacity"]))


class CompressedImage(Visualizer):
    """Pictures as JPEG or PNG, which the viewer decodes, and depth as RVL or PNG, which is decoded here.

    H.264 under this type is `CompressedImageVideo`'s.
    """

    name = "compressed_image"
    inputs = (Input(role="image", type=COMPRESSED_IMAGE),)
    parameters = (_OPACITY, _DEPTH_RANGE)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw one picture."""
        rr = rerun()
        message = update.only
        text = message.format.lower()
        if "h264" in text or "h265" in text or "hevc" in text:
            return
        canvas.place(self.entity, image_plane(message.header.frame_id, self.topics["image"]))
        data = bytes(message.data)
        if "compresseddepth" in text:
            array, encoding = decode_depth(data, parse_depth_format(message.format))
            canvas.log(self.entity, _depth(array, encoding, self["depth_max_m"]))
            return
        kind = next((kind for name, kind in _MEDIA.items() if name in text), None)
        if kind is None:
            given, allowed = repr(message.format), "name jpeg, png, h264 or compressedDepth"
            raise ContentError("compressed image format", given=given, allowed=allowed)
        canvas.log(self.entity, rr.EncodedImage(contents=data, media_type=kind, opacity=self["opacity"]))


_MEDIA = {"jpeg": "image/jpeg", "jpg": "image/jpeg", "png": "image/png"}


class CameraModel(Visualizer):
    """A camera's pinhole: hangs its pictures in space as a pyramid."""

    name = "camera_info"
    inputs = (Input(role="info", type="sensor_msgs/msg/CameraInfo", qos=LATCHED),)
    max_hz = 1.0
    parameters = (
        Parameter(
            name="distance_m", default=0.5, minimum=0.01, maximum=100.0, help="size of the pyramid in space, m"
        ),
    )

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the camera."""
        rr = rerun()
        info = update.only
        frame = info.header.frame_id
        frames = (
            {"parent_frame": frame, "child_frame": image_plane(frame, self.topics["info"])} if frame else {}
        )
        pinhole = rr.Pinhole(
            image_from_camera=pinhole_matrix(info),
            resolution=[info.width, info.height],
            camera_xyz=rr.ViewCoordinates.RDF,  # x right, y down, z forward: an optical frame, REP 103
            image_plane_distance=self["distance_m"],
            **frames,
        )
        canvas.log(self.entity, pinhole)


def _depth(array: NDArray[Any], encoding: str, max_m: float) -> Any:
    rr = rerun()
    per_metre = DEPTH_ENCODINGS.get(encoding, 1.0)
    return rr.DepthImage(array, meter=per_metre, depth_range=(0.0, max_m * per_metre), colormap="turbo")
