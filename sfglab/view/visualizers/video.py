"""Compressed video: access units go to the viewer as they are, which decodes what is looked at.

A P frame is worth nothing after a gap, so nothing is thinned out here; after a loss the stream waits for its
next key frame. Refuses to decode.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.codecs import COMPRESSED_IMAGE, COMPRESSED_VIDEO, FFMPEG_PACKET, parse_ffmpeg_encoding
from sfglab.fleet.keeper import FLAG_KEY
from sfglab.qos import COMPRESSED_STREAM
from sfglab.view.errors import ContentError
from sfglab.view.parameters import Parameter
from sfglab.view.sdk import rerun
from sfglab.view.visualizer import Canvas, Input, Update, Visualizer
from sfglab.view.visualizers.images import image_plane

if TYPE_CHECKING:
    from collections.abc import Iterator


_CODECS = {"h264": "H264", "hevc": "H265", "h265": "H265", "av1": "AV1"}
_IDR = {"h264": lambda first: first & 31 == 5, "h265": lambda first: 16 <= first >> 1 & 63 <= 21}
"""NAL unit types that a decoder can start with: ITU-T H.264, table 7-1; H.265, table 7-1."""


def has_key_frame(data: bytes, codec: str) -> bool:
    """Return whether an access unit in Annex B holds a picture that a decoder can start with.

    Args:
        data: NAL units behind start codes.
        codec: ``h264`` or ``h265``.
    """
    return any(_IDR[codec](first) for first in _nal_heads(data))


def _nal_heads(data: bytes) -> Iterator[int]:
    """Yield the first byte of every NAL unit."""
    position = data.find(b"\0\0\1")
    while 0 <= position < len(data) - 3:
        yield data[position + 3]
        position = data.find(b"\0\0\1", position + 3)


class _Video(Visualizer):
    """A stream of access units."""

    max_hz = None
    queue = 60  # two groups of pictures, as the stream's own QoS: a shorter queue would break every group
    parameters = (
        Parameter(name="opacity", default=1.0, minimum=0.0, maximum=1.0, help="1 hides what is behind"),
        Parameter(
            name="wait_for_key", default=True, help="after a loss, show nothing until the next key frame"
        ),
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._codec = ""
        self._complete = False

    def _sample(self, update: Update, canvas: Canvas, codec: str, *, is_key: bool, frame: str) -> None:
        """Pass one access unit on, if what it refers to was passed on as well."""
        rr = rerun()
        if codec not in _CODECS:
            raise ContentError("video codec", given=repr(codec), allowed=f"are {', '.join(_CODECS)}")
        if codec != self._codec:
            self._codec, self._complete = codec, False
            canvas.log(self.entity, rr.VideoStream(_CODECS[codec], opacity=self["opacity"]), static=True)
        self._complete = is_key or (self._complete and not update.lost)
        if not self._complete and self["wait_for_key"]:
            return
        canvas.place(self.entity, image_plane(frame, self.topics["video"]))
        columns = rr.VideoStream.from_fields(sample=bytes(update.only.data), is_keyframe=is_key)
        canvas.log(self.entity, columns)


class FfmpegVideo(_Video):
    """What ffmpeg_image_transport sends; it counts its packets, so also a loss on the way is noticed."""

    name = "ffmpeg_video"
    inputs = (Input(role="video", type=FFMPEG_PACKET, qos=COMPRESSED_STREAM),)

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._next_pts: int | None = None

    def show(self, update: Update, canvas: Canvas) -> None:
        """Pass one packet on."""
        message = update.only
        if self._next_pts not in (None, message.pts):
            self._complete = False
        self._next_pts = message.pts + 1
        codec = parse_ffmpeg_encoding(message.encoding).codec
        is_key = bool(message.flags & FLAG_KEY)
        self._sample(update, canvas, codec, is_key=is_key, frame=message.header.frame_id)


class FoxgloveVideo(_Video):
    """Foxglove's message, which carries its own time and frame."""

    name = "compressed_video"
    inputs = (Input(role="video", type=COMPRESSED_VIDEO, qos=COMPRESSED_STREAM),)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Pass one access unit on."""
        message = update.only
        codec = "h265" if message.format.lower() == "hevc" else message.format.lower()
        is_key = has_key_frame(bytes(message.data), codec) if codec in _IDR else not update.lost
        self._sample(update, canvas, codec, is_key=is_key, frame=message.frame_id)


class CompressedImageVideo(_Video):
    """H.264 in a ``CompressedImage`` whose format says so; other formats are `CompressedImage`'s."""

    name = "compressed_image_video"
    inputs = (Input(role="video", type=COMPRESSED_IMAGE, qos=COMPRESSED_STREAM),)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Pass one access unit on, if it is one."""
        message = update.only
        text = message.format.lower()
        codec = next((c for name, c in _FORMATS.items() if name in text), None)
        if codec is not None:
            is_key = has_key_frame(bytes(message.data), codec)
            self._sample(update, canvas, codec, is_key=is_key, frame=message.header.frame_id)


_FORMATS = {"h264": "h264", "h265": "h265", "hevc": "h265"}
