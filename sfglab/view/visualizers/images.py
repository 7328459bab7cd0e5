"""Visualizers of images: raw images, compressed still images, compressed depth images, and video.

An image is drawn in the image plane of its camera: a separate frame below the camera's optical frame, so that
`CameraModel` can place the image in space. Access units of video are sent to the viewer unchanged. Because a P frame
cannot be decoded after a gap, video has no rate limit; after a loss a stream waits for a key frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs import (
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    CodecError,
    decode_depth,
    parse_depth_format,
    parse_ffmpeg_encoding,
)
from sfglab.codecs.libav import B_FRAMES, NO_START_CODE, has_key_frame, has_start_code
from sfglab.errors import InvalidValueError
from sfglab.fleet.gop_config import FLAG_KEY
from sfglab.messages.packets import PacketOrder
from sfglab.qos import COMPRESSED_STREAM, LATCHED
from sfglab.view.geometry import pinhole_matrix, pixels
from sfglab.view.rerunning import rr
from sfglab.view.visualizer import (
    Canvas,
    Input,
    NotShownError,
    Parameter,
    Update,
    Visualizer,
    camera_name,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray


_OPACITY = Parameter("opacity", 1.0, "1 hides what is behind the picture", minimum=0.0, maximum=1.0)
_DEPTH_RANGE = Parameter(
    "depth_max_m", 10.0, "depth that has the last colour, m", minimum=0.1, maximum=1000.0
)
_MODELS = {"rgb8": "RGB", "bgr8": "BGR", "8UC3": "BGR", "rgba8": "RGBA", "bgra8": "BGRA"}


def image_plane(frame: str, topic: str) -> str:
    """Return the frame of the image plane of a stream; empty if the camera has no frame.

    Streams of one camera may have the same optical frame and different intrinsics. Therefore the frame also contains
    the `camera_name` of the topic, which an image and its camera info have in common.
    """
    return f"{frame}/image_plane{camera_name(topic)}" if frame else ""


class _Picture(Visualizer):
    """Base class: an image in the image plane of its camera."""

    parameters = (_OPACITY, _DEPTH_RANGE)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw one image."""
        picture = self._picture(update.only)
        frame = update.only.header.frame_id
        canvas.place(self.entity, image_plane(frame, self.topics["image"]))
        canvas.log(self.entity, picture)

    def _picture(self, message: Any) -> Any:
        raise NotImplementedError

    def _depth(self, array: NDArray[Any]) -> Any:
        """Return a depth image, in millimetres as uint16 or in metres as float32 (REP 118)."""
        per_metre = 1000.0 if array.dtype == np.uint16 else 1.0
        span = (0.0, self["depth_max_m"] * per_metre)
        return rr.DepthImage(array, meter=per_metre, depth_range=span, colormap="turbo")


class Image(_Picture):
    """Raw images (``sensor_msgs/msg/Image``), also depth images."""

    name = "image"
    inputs = (Input("image", "sensor_msgs/msg/Image"),)

    def _picture(self, message: Any) -> Any:
        array = pixels(message)
        if message.encoding in ("16UC1", "32FC1"):
            return self._depth(array)
        model = _MODELS.get(message.encoding, "L")
        return rr.Image(array, model, opacity=self["opacity"])


class CompressedImage(_Picture):
    """Images as JPEG or PNG, and depth images as RVL or PNG, decoded here; `CompressedImageVideo` shows H.264."""

    name = "compressed_image"
    inputs = (Input("image", COMPRESSED_IMAGE),)

    def _picture(self, message: Any) -> Any:
        text, data = message.format.lower(), bytes(message.data)
        if any(name in text for name in _FORMATS):
            raise NotShownError(f"video in {message.format!r}: shown by compressed_image_video")
        if "compresseddepth" in text:
            return self._depth(decode_depth(data, parse_depth_format(message.format))[0])
        for name, media in _MEDIA.items():
            if name in text:
                return rr.EncodedImage(contents=data, media_type=media, opacity=self["opacity"])
        allowed = "jpeg, png, h264 or compressedDepth"
        raise InvalidValueError("compressed image format", message.format, allowed)


_MEDIA = {"jpeg": "image/jpeg", "jpg": "image/jpeg", "png": "image/png"}


class CameraModel(Visualizer):
    """Pinhole model of a ``CameraInfo``, which places the camera's images in space as a pyramid."""

    name = "camera_info"
    inputs = (Input("info", "sensor_msgs/msg/CameraInfo", qos=LATCHED),)
    max_hz = 1.0
    parameters = (
        Parameter(
            "distance_m", 0.5, "size of the pyramid in space, m", minimum=0.01, maximum=100.0
        ),
    )

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw the camera's pinhole model at its optical frame; the image plane is `distance_m` away."""
        info = update.only
        frame = info.header.frame_id
        pinhole = rr.Pinhole(
            image_from_camera=pinhole_matrix(info),
            resolution=[info.width, info.height],
            camera_xyz=rr.ViewCoordinates.RDF,  # x right, y down, z forward: an optical frame, REP 103
            image_plane_distance=self["distance_m"],
            parent_frame=frame or None,
            child_frame=image_plane(frame, self.topics["info"]) or None,
        )
        canvas.log(self.entity, pinhole)


_CODECS = {"h264": "H264", "hevc": "H265", "av1": "AV1"}
_ANNEX_B = ("h264", "hevc")


class _Video(Visualizer):
    """Base class: a stream of access units."""

    max_hz = None
    queue = 60  # two GOPs, as in the stream's own QoS: a shorter queue would break every GOP
    parameters = (_OPACITY,)

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._codec = ""
        self._complete = False

    def _sample(
        self, update: Update, canvas: Canvas, codec: str, *, is_key: bool, frame: str
    ) -> None:
        """Send one access unit to the viewer.

        Raises:
            CodecError: The unit cannot be shown, or refers to a missing one.
        """
        if codec not in _CODECS:
            raise InvalidValueError("video codec", codec, ", ".join(_CODECS))
        data = bytes(update.only.data)
        if codec in _ANNEX_B and not has_start_code(data):
            raise CodecError(f"{codec} packet: {NO_START_CODE}")
        if codec != self._codec:
            self._codec, self._complete = codec, False
            stream = rr.VideoStream(_CODECS[codec], opacity=self["opacity"])
            canvas.log(self.entity, stream, static=True)
        self._complete = is_key or (self._complete and not update.lost)
        if not self._complete:
            raise CodecError(f"{codec} packet: no key frame since the start or a lost packet")
        canvas.place(self.entity, image_plane(frame, self.topics["video"]))
        canvas.log(self.entity, rr.VideoStream.from_fields(sample=data, is_keyframe=is_key))


class FfmpegVideo(_Video):
    """Video of ffmpeg_image_transport. Its packets are numbered, so a loss on the network is detected as well."""

    name = "ffmpeg_video"
    inputs = (Input("video", FFMPEG_PACKET, qos=COMPRESSED_STREAM),)

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._order = PacketOrder()
        self._has_b_frames = False

    def show(self, update: Update, canvas: Canvas) -> None:
        """Send one packet to the viewer.

        Raises:
            CodecError: The packet has another codec, cannot be shown, or refers to a missing packet.
        """
        message = update.only
        codec = parse_ffmpeg_encoding(message.encoding).codec
        is_key = bool(message.flags & FLAG_KEY)
        if self._order.missing(message.pts):
            self._complete = False
        self._has_b_frames = not is_key and (self._has_b_frames or self._order.is_reordered)
        if self._has_b_frames:
            raise CodecError(f"{codec} packet: {B_FRAMES}")
        self._sample(update, canvas, codec, is_key=is_key, frame=message.header.frame_id)


class FoxgloveVideo(_Video):
    """Video of Foxglove's ``CompressedVideo``, which has its own time and frame."""

    name = "compressed_video"
    inputs = (Input("video", COMPRESSED_VIDEO, qos=COMPRESSED_STREAM),)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Pass one access unit on."""
        message = update.only
        text = message.format.lower()
        codec = _FORMATS.get(text, text)
        data = bytes(message.data)
        is_key = has_key_frame(data, codec) if codec in _ANNEX_B else not update.lost
        self._sample(update, canvas, codec, is_key=is_key, frame=message.frame_id)


class CompressedImageVideo(_Video):
    """Video in messages ``CompressedImage`` with the format H.264 or H.265."""

    name = "compressed_image_video"
    inputs = (Input("video", COMPRESSED_IMAGE, qos=COMPRESSED_STREAM),)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Send one access unit to the viewer.

        Raises:
            NotShownError: The message is no video.
            CodecError: The unit cannot be shown, or refers to a missing one.
        """
        message = update.only
        text = message.format.lower()
        codec = next((c for name, c in _FORMATS.items() if name in text), None)
        if codec is None:
            raise NotShownError(f"picture in {message.format!r}: shown by compressed_image")
        is_key = has_key_frame(bytes(message.data), codec)
        self._sample(update, canvas, codec, is_key=is_key, frame=message.header.frame_id)


_FORMATS = {"h264": "h264", "h265": "hevc", "hevc": "hevc"}
