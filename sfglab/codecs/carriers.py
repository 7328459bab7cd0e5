"""Messages that carry compressed images: their fields as plain values, and decoders from messages to images.

The messages are ffmpeg_image_transport_msgs/FFMPEGPacket, sensor_msgs/CompressedImage and
foxglove_msgs/CompressedVideo. The module reads their attributes, except the header, and imports no class of them.

Source: ffmpeg_image_transport 3; image_transport_plugins (format strings); foxglove-sdk (CompressedVideo).
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs.depth import (
    DepthFormat,
    decode_depth,
    encode_depth,
    parse_depth_format,
)
from sfglab.codecs.errors import MAX_PIXELS, CodecError, CodecUnavailableError, kind_of
from sfglab.codecs.h264 import H264Decoder
from sfglab.codecs.libav import VideoDecoder
from sfglab.messages.packets import PacketOrder

if TYPE_CHECKING:
    from collections.abc import Callable

    from av import VideoFrame
    from numpy.typing import NDArray

    from sfglab.codecs.libav import EncodedPacket, H264Settings

FFMPEG_PACKET = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
COMPRESSED_VIDEO = "foxglove_msgs/msg/CompressedVideo"

_AV_PKT_FLAG_KEY = 1

VIDEO_CODECS = {
    **dict.fromkeys(("h264", "libx264", "libx264rgb", "libopenh264"), "h264"),
    **dict.fromkeys(("hevc", "h265", "libx265"), "hevc"),
}
"""Codecs by the names that messages and FFmpeg encoders use; ``h264_...`` and ``hevc_...`` come on top."""
_VIDEO = ("h264", "hevc")


@dataclass(frozen=True, slots=True, kw_only=True)
class FfmpegPacketFields:
    """The fields of FFMPEGPacket without its header."""

    width: int  #: Pixels per row.
    height: int  #: Rows.
    encoding: str  #: ``codec;av_pix_fmt;cv_bridge_format;ros_encoding``.
    pts: int  #: Number of the frame from 0, not a time.
    flags: int  #: FFmpeg's packet flags; bit 0 marks a key frame.
    is_bigendian: bool  #: Whether the pixels of the source image were big-endian.
    data: bytes  #: One access unit.


@dataclass(frozen=True, slots=True, kw_only=True)
class CompressedImageFields:
    """The fields of CompressedImage without its header."""

    format: str  #: Format of `data`, as the transport that reads it names it.
    data: bytes  #: The compressed image.


@dataclass(frozen=True, slots=True, kw_only=True)
class FfmpegEncoding:
    """Parsed content of the `encoding` field of FFMPEGPacket."""

    codec: str  #: ``"h264"``, ``"hevc"``, or another name.
    ros_encoding: str  #: Encoding of the image before compression; empty in older packets.


def ffmpeg_packet_fields(packet: EncodedPacket, settings: H264Settings) -> FfmpegPacketFields:
    """Return the fields of FFMPEGPacket for a packet of `H264Encoder.encode`, as ffmpeg_image_transport 3 does.

    Args:
        packet: Encoded frame.
        settings: Settings of the encoder that made it.
    """
    return FfmpegPacketFields(
        width=settings.width,
        height=settings.height,
        encoding="h264;yuv420p;bgr8;bgr8",
        pts=packet.pts,
        flags=_AV_PKT_FLAG_KEY if packet.is_key else 0,
        is_bigendian=False,
        data=packet.data,
    )


def compressed_depth_fields(depth: NDArray[Any], codec: str = "rvl") -> CompressedImageFields:
    """Return the fields of CompressedImage for a depth image, as compressed_depth_image_transport publishes it.

    Args:
        depth: Shape (rows, columns), uint16, in millimetres with 0 for holes.
        codec: ``"rvl"`` or ``"png"``.

    Raises:
        CodecError: The image has another shape or type, or the codec is another one.
    """
    depth_format, data = encode_depth(depth, codec=codec)
    return CompressedImageFields(format=str(depth_format), data=data)


def compressed_image_fields(image_bgr: NDArray[np.uint8]) -> CompressedImageFields:
    """Return the fields of CompressedImage for a colour image, as compressed_image_transport publishes it.

    The image becomes a JPEG of that plugin's default quality.

    Args:
        image_bgr: Pixels of shape (height, width, 3), BGR, uint8.

    Raises:
        CodecError: The image has another shape or type.
    """
    from sfglab.codecs.still import encode_jpeg

    if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or image_bgr.dtype != np.uint8:
        allowed = "allowed: uint8 of shape (height, width, 3)"
        raise CodecError(f"colour image: given {kind_of(image_bgr)}, {allowed}")
    return CompressedImageFields(format="bgr8; jpeg compressed bgr8", data=encode_jpeg(image_bgr))


def parse_ffmpeg_encoding(text: str) -> FfmpegEncoding:
    """Return the content of FFMPEGPacket's `encoding`.

    Newer packets have four values with semicolons between them. Older packets have only an encoder's name,
    such as ``h264_nvenc``; if it is known, the codec takes its place.
    """
    name, *rest = [part.strip() for part in text.split(";")]
    ros_encoding = rest[2] if len(rest) >= 3 else ""
    prefix = name.lower().partition("_")[0]
    known = prefix if prefix in _VIDEO else name
    return FfmpegEncoding(codec=VIDEO_CODECS.get(known.lower(), known), ros_encoding=ros_encoding)


_HINTS = (*_VIDEO, "jpeg", "png", "rvl")
_MODULES = {"jpeg": "still", "png": "still", "rvl": "rvl"}  # others are imported here already
_FORMATS = {
    "h264": "h264",
    "h265": "hevc",
    "hevc": "hevc",
    "jpeg": "jpeg",
    "jpg": "jpeg",
    "png": "png",
}
"""Codecs by the words that identify them in the field `format` of CompressedImage."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DecodedImage:
    """One image that an `ImageDecoder` decoded."""

    array: NDArray[Any]  #: Pixels, contiguous, shape (rows, columns) or (rows, columns, channels).
    encoding: str  #: ROS image encoding of `array`, such as ``"bgr8"``, ``"16UC1"`` or ``"32FC1"``.
    is_key: bool  #: Whether a decoder can start at this image.
    #: Whether all packets since the last key frame arrived. Only FFMPEGPacket numbers its packets; in other
    #: messages a loss is not detected, and the value is True.
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
        most_pixels: Largest number of pixels. A larger image is refused before memory is allocated.

    Raises:
        CodecUnavailableError: Messages of this type hold no readable images, or the hint is no codec.
    """
    readers = {
        FFMPEG_PACKET: _read_ffmpeg_packet,
        COMPRESSED_IMAGE: _read_compressed_image,
        COMPRESSED_VIDEO: _read_compressed_image,
    }
    if type_name not in readers:
        reason = f"this type holds no images; allowed: {', '.join(readers)}"
        raise CodecUnavailableError(type_name, reason=reason)
    hint = VIDEO_CODECS.get(codec_hint or "", codec_hint or "")
    if hint and hint not in _HINTS:
        reason = f"not a known codec; allowed: {', '.join(_HINTS)}"
        raise CodecUnavailableError(hint, reason=reason)
    if hint in _MODULES:
        importlib.import_module(f"sfglab.codecs.{_MODULES[hint]}")
    return ImageDecoder(readers[type_name], hint, most_pixels)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Content:
    """Content of a message: its bytes, the codec as the message names it, and values for that codec."""

    codec: str
    data: bytes
    ros_encoding: str = ""
    depth_format: DepthFormat | None = None
    pts: int | None = None


def _read_ffmpeg_packet(message: Any) -> _Content:
    encoding = parse_ffmpeg_encoding(message.encoding)
    if "16" in encoding.ros_encoding or "32" in encoding.ros_encoding:
        reason = "video of more than 8 bits cannot be decoded to BGR; publish 8 bits per channel"
        raise CodecUnavailableError(message.encoding, reason=reason)
    return _Content(codec=encoding.codec, data=bytes(message.data), pts=int(message.pts))


def _read_compressed_image(message: Any) -> _Content:
    text, data = message.format.lower(), bytes(message.data)
    if "compresseddepth" in text:
        return _Content(codec="depth", data=data, depth_format=parse_depth_format(message.format))
    named = [codec for word, codec in _FORMATS.items() if word in text]
    codec = named[0] if named else message.format
    return _Content(codec=codec, data=data, ros_encoding=message.format.partition(";")[0].strip())


class ImageDecoder:
    """A decoder from the messages of one stream, of any of the three types, to images."""

    def __init__(self, read: Callable[[Any], _Content], codec_hint: str, most_pixels: int) -> None:
        self._read = read
        self._hint = codec_hint
        self._most_pixels = most_pixels
        self._video = self._video_decoder(codec_hint) if codec_hint in _VIDEO else None
        self._order = PacketOrder()
        self._intact = True

    def feed(self, message: Any) -> tuple[DecodedImage, ...]:
        """Decode one message to images: one, or none while a video decoder waits for a key frame.

        After an error the decoder accepts the next message.

        Raises:
            CodecError: The message cannot be decoded; `BitstreamError` if its bytes are damaged,
                `CodecUnavailableError` if its codec is unknown.
        """
        content = self._read(message)
        codec = self._codec(content)
        if codec in _VIDEO:
            video, frames = self._decode_packet(codec, content)
            images = []
            for frame in frames:
                pixels = video.bgr(frame)
                image = DecodedImage(
                    array=pixels, encoding="bgr8", is_key=frame.key_frame, intact=self._intact
                )
                images.append(image)
            return tuple(images)
        if codec in ("depth", "rvl"):
            depth_format = content.depth_format or DepthFormat(encoding="", codec="rvl")
            array, encoding = decode_depth(
                content.data, depth_format, most_pixels=self._most_pixels
            )
        elif codec in _HINTS:
            array, encoding = _decode_still(content, self._most_pixels)
        else:
            reason = f"unknown; allowed: {', '.join(_HINTS)}; name the right one as codec_hint"
            raise CodecUnavailableError(content.codec, reason=reason)
        return (DecodedImage(array=array, encoding=encoding, is_key=True, intact=True),)

    def skip(self, message: Any) -> None:
        """Process one message whose image is not wanted, so that the next messages can be decoded.

        The method costs less than `feed`: it converts no frame to pixels, and does not decode still images.

        Raises:
            CodecError: As for `feed`.
        """
        content = self._read(message)
        codec = self._codec(content)
        if codec in _VIDEO:
            self._decode_packet(codec, content)

    def _codec(self, content: _Content) -> str:
        return content.codec if content.codec in ("depth", *_HINTS) else self._hint

    def _decode_packet(
        self, codec: str, content: _Content
    ) -> tuple[VideoDecoder, tuple[VideoFrame, ...]]:
        if self._video is None or self._video.codec != codec:
            self._video = self._video_decoder(codec)
        if content.pts is not None:
            self._intact &= not self._order.missing(content.pts)
        frames = self._video.decode(content.data)
        for frame in frames:
            self._intact |= frame.key_frame
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
