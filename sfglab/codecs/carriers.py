"""The fields of the ROS messages that carry compressed images.

Knows ffmpeg_image_transport_msgs/FFMPEGPacket, sensor_msgs/CompressedImage and foxglove_msgs/CompressedVideo
as plain values, headers left out. Refuses to know message classes; `sfglab.codecs.decoding` reads them.

Source: ffmpeg_image_transport 3 (FFMPEGPacket); image_transport_plugins (format strings); foxglove-sdk
(CompressedVideo).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs.depth import PNG_LEVEL, encode_depth
from sfglab.codecs.errors import CodecError

if TYPE_CHECKING:
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
class CompressedVideoFields:
    """The fields of CompressedVideo without its time and frame."""

    data: bytes  #: One access unit, Annex B.
    format: str  #: ``"h264"``.


@dataclass(frozen=True, slots=True, kw_only=True)
class FfmpegEncoding:
    """What the `encoding` field of FFMPEGPacket says."""

    codec: str  #: ``"h264"``, ``"hevc"``, or whatever else was named.
    ros_encoding: str  #: Encoding of the image before compression; empty in older packets.


def ffmpeg_packet_fields(frame: EncodedFrame, settings: H264Settings) -> FfmpegPacketFields:
    """Return one encoded frame as ffmpeg_image_transport 3 publishes it.

    Args:
        frame: From `H264Encoder.encode`.
        settings: The encoder's settings.
    """
    return FfmpegPacketFields(
        width=settings.width,
        height=settings.height,
        encoding="h264;yuv420p;bgr8;bgr8",
        pts=frame.pts,
        flags=_AV_PKT_FLAG_KEY if frame.is_key else 0,
        is_bigendian=False,
        data=frame.data,
    )


def compressed_video_fields(frame: EncodedFrame) -> CompressedVideoFields:
    """Return one encoded frame as Foxglove takes it: no B-frames, parameter sets in each key frame."""
    return CompressedVideoFields(data=frame.data, format="h264")


def compressed_depth_fields(
    depth: NDArray[Any], codec: str = "rvl", *, depth_max_m: float | None = None, png_level: int = PNG_LEVEL
) -> CompressedImageFields:
    """Return a depth image as compressed_depth_image_transport publishes it; see `encode_depth`.

    Raises:
        CodecError: If the image or the codec is of another kind.
    """
    depth_format, data = encode_depth(depth, codec=codec, depth_max_m=depth_max_m, png_level=png_level)
    return CompressedImageFields(format=str(depth_format), data=data)


def compressed_image_fields(image_bgr: NDArray[np.uint8], codec: str = "jpeg") -> CompressedImageFields:
    """Return a colour image as compressed_image_transport publishes it, with its default quality or level.

    Args:
        image_bgr: Pixels, shape (height, width, 3), uint8.
        codec: ``"jpeg"`` or ``"png"``.

    Raises:
        CodecError: If the image or the codec is of another kind.
    """
    from sfglab.codecs.still import encode_jpeg, encode_png

    if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or image_bgr.dtype != np.uint8:
        raise CodecError(
            f"colour image: given {image_bgr.dtype} of shape {image_bgr.shape}, "
            f"allowed is uint8 of shape (height, width, 3)"
        )
    if codec == "jpeg":
        data = encode_jpeg(image_bgr)
    elif codec == "png":
        data = encode_png(image_bgr, level=_COLOUR_PNG_LEVEL)
    else:
        raise CodecError(f"colour codec: given {codec!r}, allowed are 'jpeg' and 'png'")
    return CompressedImageFields(format=f"bgr8; {codec} compressed bgr8", data=data)


def parse_ffmpeg_encoding(text: str) -> FfmpegEncoding:
    """Read the `encoding` field of FFMPEGPacket: four values since version 3, an encoder's name before.

    ``"libx264"``, ``"h264_nvmpi"`` and the like become their codec; a codec that is not known stays as it is.
    """
    name, *rest = [part.strip() for part in text.split(";")]
    ros_encoding = rest[2] if len(rest) >= 3 else ""
    known = next((codec for codec in _CODEC_PREFIXES if name.lower().startswith(f"{codec}_")), name)
    return FfmpegEncoding(codec=VIDEO_CODECS.get(known.lower(), known), ros_encoding=ros_encoding)
