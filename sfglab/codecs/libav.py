"""One FFmpeg encoder or decoder for a video stream, and the NAL units of Annex B streams.

An encoder gives one packet per frame, at a constant bit rate, and a decoder one frame per packet. `probe`
chooses among them.

Source: ITU-T H.264, Annex B and table 7-1; ITU-T H.265, Annex B and table 7-1; paper A, section 4.3, table 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, NoReturn, cast

import av
import numpy as np
from av.codec.codec import UnknownCodecError
from av.codec.context import Flags, ThreadType
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType
from av.video.reformatter import ColorRange, Colorspace, Interpolation, VideoReformatter

from sfglab.codecs.errors import (
    MAX_PIXELS,
    BitstreamError,
    CodecError,
    CodecUnavailableError,
    kind_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

# BT.601, limited range: the matrix of swscale's defaults, which ffmpeg_image_transport uses on both sides
# without looking at the stream (ffmpeg_encoder_decoder, encoder.cpp and decoder.cpp), and of OpenCV's YUV
# conversions. It is also written into the stream (VUI), so readers that evaluate the VUI get the same colours.
# SMPTE 170M in ITU-T H.264, table E-5; the same number means BT.601 primaries and transfer
_MATRIX = 6
_RANGE = ColorRange.MPEG


@dataclass(frozen=True, slots=True, kw_only=True)
class H264Settings:
    """Settings of the encoder of a camera stream.

    Raises:
        CodecError: A side is odd or not positive, the image has more than `MAX_PIXELS`, or another value is not
            positive.
    """

    width: int  #: Pixels per row, even.
    height: int  #: Rows, even.
    fps: float  #: Frames per second.
    bitrate_bps: int  #: Constant bit rate in bits per second.
    gop: int  #: Frames from one key frame to the next.
    #: ``"auto"``, or an FFmpeg encoder such as ``"libx264"`` or ``"h264_nvenc"``.
    encoder: str = "auto"

    def __post_init__(self) -> None:
        is_even = self.width % 2 == self.height % 2 == 0
        is_small = min(self.width, self.height) > 0 and self.width * self.height <= MAX_PIXELS
        if not is_even or not is_small:
            allowed = f"allowed: even sides and at most {MAX_PIXELS} pixels"
            raise CodecError(f"H.264 size: given {self.width} x {self.height}, {allowed}")
        for name in ("fps", "bitrate_bps", "gop"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise CodecError(f"H.264 {name}: given {value}, allowed: positive numbers")


TABLE_2 = H264Settings(width=640, height=360, fps=30, bitrate_bps=4_000_000, gop=30)
"""The camera stream of paper A, table 2; the encoder there is ``h264_nvmpi``, its buffer size is not stated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodedPacket:
    """One encoded frame, which is one access unit of H.264."""

    data: bytes  #: Annex B bytes; key frames hold the parameter sets.
    pts: int  #: Number of the frame, from 0.
    is_key: bool  #: Whether a decoder may start here.


# The encoders' own options for no look-ahead, forced IDR frames and a constant rate.
_OPTIONS = {
    # superfast keeps CABAC and the loop filter, as camera hardware does, so decoding takes a realistic time;
    # ultrafast drops both, and decoding then takes a third of that time.
    "libx264": {"preset": "superfast", "tune": "zerolatency", "forced-idr": "1"},
    "h264_nvenc": {
        "tune": "ull",
        "zerolatency": "1",
        "delay": "0",
        "rc": "cbr",
        "forced-idr": "1",
    },
    "h264_qsv": {"async_depth": "1", "forced_idr": "1", "low_delay_brc": "1"},
    "h264_vaapi": {"async_depth": "1", "rc_mode": "CBR"},
    "h264_amf": {"usage": "ultralowlatency", "rc": "cbr", "forced_idr": "1", "filler_data": "1"},
}


def why(error: BaseException) -> str:
    """Return the cause of an FFmpeg error as a phrase, without FFmpeg's call and options."""
    if isinstance(error, UnknownCodecError):
        return "not in this build of FFmpeg"
    if isinstance(error, av.FFmpegError):
        return f"{error.strerror} ({type(error).__name__})"
    return str(error)


def _context(name: str, mode: str) -> VideoCodecContext:
    context = av.CodecContext.create(name, "w" if mode == "w" else "r")
    if not isinstance(context, VideoCodecContext):
        raise CodecError(f"codec {name!r}: not a video codec")
    return context


class VideoEncoder:
    """An FFmpeg encoder of one H.264 stream, chosen by FFmpeg's name, such as ``"libx264"``.

    Raises:
        CodecError: The encoder cannot be opened with these settings.
    """

    def __init__(self, name: str, settings: H264Settings) -> None:
        self.settings = settings  #: Settings of the stream.
        self.encoder_name = name  #: The FFmpeg encoder that was opened.
        self._reformatter = VideoReformatter()
        self._shape = (settings.height, settings.width, 3)
        self._next_pts = 0
        try:
            self._context = self._opened()
        except (av.FFmpegError, ValueError) as error:
            reason = f"H.264 encoder {name!r} refuses {settings} ({why(error)}); sfglab doctor lists others"
            raise CodecError(reason) from error

    def encode(
        self, image_bgr: NDArray[np.uint8], *, force_key: bool = False
    ) -> tuple[EncodedPacket, ...]:
        """Encode one image, shape (height, width, 3), BGR, uint8, and return exactly one packet.

        With `force_key` the packet is an extra key frame, and the next regular key frame follows one GOP later.

        Raises:
            CodecError: The image does not fit the settings, or the encoder delays the packet or fails.
        """
        if image_bgr.shape != self._shape or image_bgr.dtype != np.uint8:
            allowed = f"allowed: uint8 of shape {self._shape}"
            raise CodecError(f"H.264 encoder: given {kind_of(image_bgr)}, {allowed}")
        frame = self._planes(np.ascontiguousarray(image_bgr))
        frame.pts, frame.time_base = self._next_pts, self._context.time_base
        frame.pict_type = PictureType.I if force_key else PictureType.NONE
        self._next_pts += 1
        try:
            packets = self._context.encode(frame)
        except av.FFmpegError as error:
            raise CodecError(f"H.264 encoder {self.encoder_name!r} failed: {why(error)}") from error
        if len(packets) != 1:
            reason = f"gave {len(packets)} packets for one frame, wanted 1 at once"
            raise CodecError(f"H.264 encoder {self.encoder_name!r} {reason}")
        (packet,) = packets
        data = bytes(packet)
        return (EncodedPacket(data=data, pts=packet.pts or 0, is_key=packet.is_keyframe),)

    def _opened(self) -> VideoCodecContext:
        settings, name = self.settings, self.encoder_name
        context = _context(name, "w")
        formats = [entry.name for entry in context.codec.video_formats or ()]
        context.pix_fmt = "yuv420p" if not formats or "yuv420p" in formats else "nv12"
        context.width, context.height = settings.width, settings.height
        context.framerate = Fraction(settings.fps).limit_denominator(1001)
        context.time_base = 1 / context.framerate
        context.bit_rate, context.gop_size = settings.bitrate_bps, settings.gop
        context.max_b_frames = 0
        context.color_range, context.colorspace = _RANGE, _MATRIX
        context.color_primaries = context.color_trc = _MATRIX
        context.thread_count = 1
        rate = str(settings.bitrate_bps)
        # A buffer of one average frame gives packets of equal size.
        buffer_bits = int(settings.bitrate_bps / settings.fps)
        options = {"maxrate": rate, "minrate": rate, "bufsize": str(buffer_bits)}
        options |= _OPTIONS.get(name, {})
        if name == "libx264":
            options["x264-params"] = f"nal-hrd=cbr:scenecut=0:min-keyint={settings.gop}"
        context.options = options
        context.open()
        return context

    def _planes(self, image_bgr: NDArray[np.uint8]) -> av.VideoFrame:
        # Accurate rounding halves the colour error; it costs the sender 0.3 ms and the receivers nothing.
        return self._reformatter.reformat(
            av.VideoFrame.from_numpy_buffer(image_bgr, "bgr24"),
            format=self._context.pix_fmt,
            dst_colorspace=Colorspace.ITU601,
            dst_color_range=_RANGE,
            interpolation=Interpolation.BILINEAR | Interpolation.ACCURATE_RND,
            threads=1,
        )


class VideoDecoder:
    """An FFmpeg decoder of one H.264 or H.265 stream. It starts, and continues after an error, at a key frame.

    The class does not detect missing packets: libavcodec decodes with the wrong reference frame and marks no
    frame until the next key frame. `sfglab.codecs.carriers` counts packets if their messages number them.
    Streams with B frames are refused, because their frames come later than the packets and would get wrong time
    stamps.

    Args:
        codec: ``"h264"`` or ``"hevc"``.
        decoder: FFmpeg's name of the decoder.
        most_pixels: Largest number of pixels of a frame.

    Raises:
        CodecError: The decoder cannot be opened.
    """

    def __init__(self, codec: str, *, decoder: str, most_pixels: int = MAX_PIXELS) -> None:
        self.codec = codec  #: Codec of the stream, ``"h264"`` or ``"hevc"``.
        self.decoder_name = decoder  #: The FFmpeg decoder that was opened.
        self.waiting = True  #: Whether packets are skipped until the next key frame.
        self.refused_packets = 0  #: Packets that were skipped while waiting for a key frame.
        self._most_pixels = most_pixels
        self._reformatter = VideoReformatter()
        self._context = self._opened()

    def decode(self, data: bytes) -> tuple[av.VideoFrame, ...]:
        """Decode one packet, an access unit in Annex B, and return its frame.

        The result is empty while the decoder waits for a key frame, and for a packet of parameter sets alone.

        Raises:
            BitstreamError: The packet is damaged or has B frames. The decoder then waits for the next key frame.
        """
        if not has_start_code(data):
            self._fail(data, NO_START_CODE)
        if self.waiting and not is_entry_point(data, codec=self.codec):
            self.refused_packets += 1
            if self.refused_packets % _MANY == 0:
                self._fail(data, f"{self.refused_packets} packets were skipped before a key frame")
            return ()
        try:
            frames = self._context.decode(av.Packet(data))
            if not frames and has_key_frame(data, self.codec):
                # An earlier packet made libavcodec expect B frames: it would lag from now on.
                self._context = self._opened()
                frames = self._context.decode(av.Packet(data))
        except av.FFmpegError as error:
            self._fail(data, f"libavcodec: {why(error)}")
        if not frames and self._context.has_b_frames:
            self._context = self._opened()
            self._fail(data, B_FRAMES)
        if any(frame.is_corrupt for frame in frames):
            self._fail(data, "slices are damaged")
        self.waiting &= not frames
        return tuple(frames)

    def decode_bgr(self, data: bytes) -> tuple[NDArray[np.uint8], ...]:
        """Decode one packet and return the pixels of its frame, (height, width, 3), BGR; see `decode` and `bgr`."""
        return tuple(map(self.bgr, self.decode(data)))

    def bgr(self, frame: av.VideoFrame) -> NDArray[np.uint8]:
        """Return the pixels of a frame, shape (height, width, 3), BGR, uint8, contiguous.

        The colour matrix and range are those that the stream names, or else BT.601. The method uses one
        reformatter with bilinear interpolation in one thread. It takes at most a quarter of the time of
        ``frame.to_ndarray(format="bgr24")``, which builds a new context for each frame.

        Raises:
            CodecUnavailableError: swscale cannot convert the frame's pixel format.
        """
        try:
            image = self._reformatter.reformat(
                frame, format="bgr24", interpolation=Interpolation.BILINEAR, threads=1
            )
        except (av.FFmpegError, ValueError) as error:
            reason = f"not convertible: {why(error)}"
            raise CodecUnavailableError(frame.format.name, reason=reason) from error
        plane = image.planes[0]
        rows = np.frombuffer(cast("memoryview", plane), np.uint8).reshape(-1, plane.line_size)
        pixels = np.ascontiguousarray(rows[: frame.height, : 3 * frame.width])
        return pixels.reshape(frame.height, frame.width, 3)

    def reset(self) -> None:
        """Discard the reference frames, keep the parameter sets, and wait for the next key frame."""
        self._context.flush_buffers()
        self.waiting = True

    def _opened(self) -> VideoCodecContext:
        try:
            context = _context(self.decoder_name, "r")
            # A second thread rarely saves time below full HD, and never at 640 x 360.
            context.thread_type, context.thread_count = ThreadType.SLICE, 1
            context.flags |= Flags.low_delay
            context.options = {"max_pixels": str(self._most_pixels), "err_detect": "explode"}
            # Wrappers of hardware decoders do not all take the generic options; that is no reason to refuse them.
            context.open(strict=False)
        except (av.FFmpegError, ValueError) as error:
            reason = f"decoder {self.decoder_name!r} cannot be opened ({why(error)}); available_decoders() lists others"
            raise CodecError(reason) from error
        return context

    def _fail(self, data: bytes, reason: str) -> NoReturn:
        self.reset()
        raise BitstreamError(self.codec, reason=reason, size_bytes=len(data))


NO_START_CODE = "no Annex B start code (0 0 1 or 0 0 0 1) in front; AVCC is not supported"
B_FRAMES = "the stream has, or declares, B frames, which are not supported: encode without them"
_MANY = 300  # more packets than the longest group of pictures has
_KEY_SLICES = {"h264": frozenset({5}), "hevc": frozenset(range(16, 24))}  # IDR and IRAP slices
_PARAMETER_SETS = {"h264": frozenset({7}), "hevc": frozenset({32, 33})}  # sequence and video


def has_start_code(data: bytes) -> bool:
    """Return whether bytes start with a start code of Annex B; AVCC, as in MP4 files, starts with a length."""
    return data.startswith((b"\0\0\1", b"\0\0\0\1"))


def nal_unit_types(data: bytes, *, codec: str) -> Iterator[int]:
    """Yield the type of each NAL unit in Annex B bytes, as the codec's table 7-1 numbers it.

    The codec is ``"h264"`` (ITU-T H.264) or ``"hevc"`` (ITU-T H.265).
    """
    at = data.find(b"\0\0\1")
    while 0 <= at < len(data) - 3:
        header = data[at + 3]
        yield header & 0x1F if codec == "h264" else header >> 1 & 0x3F
        at = data.find(b"\0\0\1", at + 3)


def is_entry_point(data: bytes, *, codec: str) -> bool:
    """Return whether a decoder can start at this packet: a key frame, or a packet of parameter sets alone."""
    wanted = _KEY_SLICES[codec] | _PARAMETER_SETS[codec]
    return not wanted.isdisjoint(nal_unit_types(data, codec=codec))


def has_key_frame(data: bytes, codec: str) -> bool:
    """Return whether an access unit contains a slice of a key frame; parameter sets alone do not count."""
    return not _KEY_SLICES[codec].isdisjoint(nal_unit_types(data, codec=codec))
