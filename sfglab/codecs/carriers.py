"""Messages that carry compressed images: their fields as plain values, and the way from a message to a picture.

Knows ffmpeg_image_transport_msgs/FFMPEGPacket, sensor_msgs/CompressedImage and foxglove_msgs/CompressedVideo,
headers left out, by their attributes. Refuses to know nodes and clocks.

Source: ffmpeg_image_transport 3; image_transport_plugins (format strings); foxglove-sdk (CompressedVideo).
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs.depth import (
    PNG_LEVEL,
    DepthFormat,
    decode_depth,
    encode_depth,
    parse_depth_format,
)
from sfglab.codecs.errors import MAX_PIXELS, CodecError, CodecUnavailableError, kind_of
from sfglab.codecs.h264 import H264Decoder, VideoDecoder

if TYPE_CHECKING:
    from collections.abc import Callable

    from av import VideoFrame
    from numpy.typing import NDArray

    from sfglab.codecs.libav import EncodedFrame, H264Settings

FFMPEG_PACKET = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
COMPRESSED_VIDEO = "foxglove_msgs/msg/CompressedVideo"

_AV_PKT_FLAG_KEY = 1
_COLOUR_PNG_LEVEL = 3  # compressed_image_transport's default

VIDEO_CODECS = {
    **dict.fromkeys(("h264", "libx264", "libx264rgb", "libopenh264"), "h264"),
    **dict.fromkeys(("hevc", "h265", "libx265"), "hevc"),
}
"""Codecs by the names that messages and FFmpeg encoders use; ``h264_...`` and ``hevc_...`` come on top."""
_CODEC_PREFIXES = ("h264", "hevc")


@dataclass(frozen=True, slots=True, kw_only=True)
class FfmpegPacketFields:
    """The fields of FFMPEGPacket without its header."""

    width: int  #: Pixels per row.
    height: int  #: Rows.
    encoding: str  #: ``codec;av_pix_fmt;cv_bridge_format;ros_encoding``.
    pts: int  #: Number of the frame from 0, not a time.
    flags: int  #: FFmpeg's packet flags; bit 0 marks a key frame.
    is_bigendian: bool  #: Whether the source pixels were.
    data: bytes  #: One access unit.


@dataclass(frozen=True, slots=True, kw_only=True)
class CompressedImageFields:
    """The fields of CompressedImage without its header."""

    format: str  #: What `data` is, in the words of the transport that reads it.
    data: bytes  #: The compressed image.


@dataclass(frozen=True, slots=True, kw_only=True)
class FfmpegEncoding:
    """What the `encoding` field of FFMPEGPacket says."""

    codec: str  #: ``"h264"``, ``"hevc"``, or whatever else was named.
    ros_encoding: str  #: Encoding of the image before compression; empty in older packets.


def ffmpeg_packet_fields(frame: EncodedFrame, settings: H264Settings) -> FfmpegPacketFields:
    """Return one frame of `H264Encoder.encode`, of these settings, as ffmpeg_image_transport 3 publishes it."""
    return FfmpegPacketFields(
        width=settings.width,
        height=settings.height,
        encoding="h264;yuv420p;bgr8;bgr8",
        pts=frame.pts,
        flags=_AV_PKT_FLAG_KEY if frame.is_key else 0,
        is_bigendian=False,
        data=frame.data,
    )


def compressed_depth_fields(
    depth: NDArray[Any],
    codec: str = "rvl",
    *,
    depth_max_m: float | None = None,
    png_level: int = PNG_LEVEL,
) -> CompressedImageFields:
    """Return a depth image as compressed_depth_image_transport publishes it; see `encode_depth`.

    Raises:
        CodecError: If the image or the codec is of another kind.
    """
    depth_format, data = encode_depth(
        depth, codec=codec, depth_max_m=depth_max_m, png_level=png_level
    )
    return CompressedImageFields(format=str(depth_format), data=data)


def compressed_image_fields(
    image_bgr: NDArray[np.uint8], codec: str = "jpeg"
) -> CompressedImageFields:
    """Return a colour image as compressed_image_transport publishes it, with its default quality or level.

    Pixels have the shape (height, width, 3), BGR, uint8, and the codec is ``"jpeg"`` or ``"png"``; anything
    else is a CodecError.
    """
    from sfglab.codecs.still import encode_jpeg, encode_png

    if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or image_bgr.dtype != np.uint8:
        given = kind_of(image_bgr)
        raise CodecError(
            f"colour image: given {given}, allowed is uint8 of shape (height, width, 3)"
        )
    if codec == "jpeg":
        data = encode_jpeg(image_bgr)
    elif codec == "png":
        data = encode_png(image_bgr, level=_COLOUR_PNG_LEVEL)
    else:
        raise CodecError(f"colour codec: given {codec!r}, allowed are 'jpeg' and 'png'")
    return CompressedImageFields(format=f"bgr8; {codec} compressed bgr8", data=data)


def parse_ffmpeg_encoding(text: str) -> FfmpegEncoding:
    """Read FFMPEGPacket's `encoding`: four values, or an encoder's name, which becomes its codec if known."""
    name, *rest = [part.strip() for part in text.split(";")]
    ros_encoding = rest[2] if len(rest) >= 3 else ""
    known = next((codec for codec in _CODEC_PREFIXES if name.lower().startswith(f"{codec}_")), name)
    return FfmpegEncoding(codec=VIDEO_CODECS.get(known.lower(), known), ros_encoding=ros_encoding)


_HINTS = ("h264", "hevc", "jpeg", "png", "rvl")
_VIDEO = ("h264", "hevc")
_LOADED_WITH = {
    codec: f"sfglab.codecs.{module}"
    for codec, module in (("jpeg", "still"), ("png", "still"), ("rvl", "rvl"))
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedImage:
    """One picture."""

    array: NDArray[Any]  #: Pixels, contiguous, shape (rows, columns) or (rows, columns, channels).
    encoding: str  #: ROS image encoding of `array`, such as ``"bgr8"``, ``"16UC1"`` or ``"32FC1"``.
    is_key: bool  #: Whether a decoder could have started here.
    #: False from a video packet that is known to be missing until the next key frame. Only FFMPEGPacket counts
    #: its packets; elsewhere a loss goes unnoticed.
    intact: bool


def image_decoder(
    type_name: str, codec_hint: str | None = None, *, most_pixels: int = MAX_PIXELS
) -> ImageDecoder:
    """Return a decoder for one stream of messages.

    The codec is read from each message, so a stream may change it.

    Args:
        type_name: ROS type of the messages: `FFMPEG_PACKET`, `COMPRESSED_IMAGE` or `COMPRESSED_VIDEO`.
        codec_hint: Expected codec: ``"h264"``, ``"hevc"``, ``"jpeg"``, ``"png"`` or ``"rvl"``; empty or None
            for none. The codec is loaded here, so that the first message does not wait for it (0.1 s for
            H.264, up to 2 s for depth). It is used for messages that name no known codec.
        most_pixels: Largest number of pixels. A larger picture is refused before memory is allocated.

    Raises:
        CodecUnavailableError: If messages of this type hold no readable images, or the hint is no codec.
    """
    readers = {
        FFMPEG_PACKET: _read_ffmpeg_packet,
        COMPRESSED_IMAGE: _read_compressed_image,
        COMPRESSED_VIDEO: _read_compressed_video,
    }
    reader = readers.get(type_name)
    if reader is None:
        raise CodecUnavailableError(
            type_name, reason=f"no images in it; allowed are {', '.join(readers)}"
        )
    hint = VIDEO_CODECS.get(codec_hint or "", codec_hint or "")
    if hint and hint not in _HINTS:
        raise CodecUnavailableError(
            hint, reason=f"not a known codec; allowed are {', '.join(_HINTS)}"
        )
    if hint in _LOADED_WITH:
        importlib.import_module(_LOADED_WITH[hint])
    return ImageDecoder(reader, hint, most_pixels)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Content:
    """What a message holds: the codec as the message names it, and what else matters for that codec."""

    codec: str
    data: bytes
    ros_encoding: str = ""
    depth_format: DepthFormat | None = None
    pts: int | None = None


def _read_ffmpeg_packet(message: Any) -> _Content:
    encoding = parse_ffmpeg_encoding(message.encoding)
    if any(width in encoding.ros_encoding for width in ("16", "32")):
        reason = (
            "pictures of more than 8 bits in video are not decoded, because BGR would drop the rest"
        )
        raise CodecUnavailableError(message.encoding, reason=reason)
    return _Content(codec=encoding.codec, data=bytes(message.data), pts=int(message.pts))


def _read_compressed_video(message: Any) -> _Content:
    return _Content(
        codec=VIDEO_CODECS.get(message.format.lower(), message.format), data=bytes(message.data)
    )


def _read_compressed_image(message: Any) -> _Content:
    text, data = message.format.lower(), bytes(message.data)
    if "compresseddepth" in text:
        return _Content(codec="depth", data=data, depth_format=parse_depth_format(message.format))
    names = {
        "h264": "h264",
        "h265": "hevc",
        "hevc": "hevc",
        "jpeg": "jpeg",
        "jpg": "jpeg",
        "png": "png",
    }
    codec = next((codec for name, codec in names.items() if name in text), message.format)
    return _Content(codec=codec, data=data, ros_encoding=message.format.partition(";")[0].strip())


class ImageDecoder:
    """A decoder from the messages of one stream, whatever their type, to pictures; see `image_decoder`."""

    def __init__(self, read: Callable[[Any], _Content], codec_hint: str, most_pixels: int) -> None:
        self._read = read
        self._hint = codec_hint
        self._most_pixels = most_pixels
        self._video: VideoDecoder | None = (
            self._video_decoder(codec_hint) if codec_hint in _VIDEO else None
        )
        self._next_pts: int | None = None
        self._intact = True

    def feed(self, message: Any) -> tuple[DecodedImage, ...]:
        """Decode one message to pictures, which come at once or never; CodecError for this one alone."""
        content = self._read(message)
        codec = self._codec(content)
        if codec in _VIDEO:
            return self._decode_video(codec, content)
        if codec in ("depth", "rvl"):
            depth_format = content.depth_format or DepthFormat(encoding="", codec="rvl")
            array, encoding = decode_depth(
                content.data, depth_format, most_pixels=self._most_pixels
            )
        elif codec in ("jpeg", "png"):
            array, encoding = _decode_still(content, self._most_pixels)
        else:
            reason = f"a message names it, but known are {', '.join(_HINTS)}; if it is one of them, hint it"
            raise CodecUnavailableError(content.codec, reason=reason)
        return (DecodedImage(array=array, encoding=encoding, is_key=True, intact=True),)

    def skip(self, message: Any) -> None:
        """Take one message whose picture nobody wants, so that the next ones can be decoded.

        Cheaper than `feed`: nothing is converted to pixels, and a still image is passed over unread.

        Raises:
            CodecError: As `feed`.
        """
        content = self._read(message)
        codec = self._codec(content)
        if codec in _VIDEO:
            self._decode_packet(codec, content)

    def reset(self) -> None:
        """Forget the stream's past, as after a pause: the reference frames and the count of packets."""
        self._next_pts, self._intact = None, True
        if self._video is not None:
            self._video.reset()

    def _codec(self, content: _Content) -> str:
        return content.codec if content.codec in ("depth", *_HINTS) else self._hint

    def _decode_video(self, codec: str, content: _Content) -> tuple[DecodedImage, ...]:
        video, frames = self._decode_packet(codec, content)
        return tuple(
            DecodedImage(
                array=video.bgr(frame), encoding="bgr8", is_key=frame.key_frame, intact=self._intact
            )
            for frame in frames
        )

    def _decode_packet(
        self, codec: str, content: _Content
    ) -> tuple[VideoDecoder, tuple[VideoFrame, ...]]:
        if self._video is None or self._video.codec != codec:
            self._video = self._video_decoder(codec)
        if content.pts is not None:
            self._intact &= self._next_pts in (None, content.pts)
            self._next_pts = content.pts + 1
        frames = self._video.decode(content.data)
        self._intact |= any(frame.key_frame for frame in frames)
        return self._video, frames

    def _video_decoder(self, codec: str) -> VideoDecoder:
        if codec == "h264":
            return H264Decoder(most_pixels=self._most_pixels)
        return VideoDecoder(codec, decoder=codec, most_pixels=self._most_pixels)


def _decode_still(content: _Content, most_pixels: int) -> tuple[NDArray[Any], str]:
    from sfglab.codecs.still import decode_still

    array = decode_still(content.data, most_pixels=most_pixels)
    bits = 8 * array.dtype.itemsize
    if array.ndim == 2:
        same = content.ros_encoding in (f"{bits}UC1", f"mono{bits}")
        return array, content.ros_encoding if same else f"mono{bits}"
    return array, f"bgr{bits}" if array.shape[2] == 3 else f"bgra{bits}"
