"""H.264 and H.265 bytes: entry points of Annex B streams, and one opened FFmpeg encoder or decoder.

Knows the options that make each encoder give one packet per frame at a constant bit rate, and the cheapest way
from planes to BGR. Refuses to choose a codec (`probe`) and to keep a stream's state (`h264`).

Source: ITU-T H.264, Annex B and table 7-1; ITU-T H.265, Annex B and table 7-1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, cast

import av
import numpy as np
from av.codec.context import Flags, ThreadType
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType
from av.video.reformatter import ColorRange, Colorspace, Interpolation, VideoReformatter

from sfglab.codecs.errors import MAX_PIXELS, CodecError, kind_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

# BT.601, limited range: the matrix of swscale's defaults, which ffmpeg_image_transport uses on both sides
# without looking at the stream (ffmpeg_encoder_decoder, encoder.cpp and decoder.cpp), and of OpenCV's YUV
# conversions. It is also written into the stream (VUI), so readers that look see the same colours.
# SMPTE 170M in ITU-T H.264, table E-5; the same number means BT.601 primaries and transfer
_MATRIX = 6
_RANGE = ColorRange.MPEG


@dataclass(frozen=True, slots=True, kw_only=True)
class H264Settings:
    """How a camera stream is encoded."""

    width: int  #: Pixels per row, even.
    height: int  #: Rows, even.
    fps: float  #: Frames per second.
    bitrate_bps: int  #: Constant bit rate in bits per second.
    gop: int  #: Frames from one key frame to the next.
    #: ``"auto"``, or an FFmpeg encoder such as ``"libx264"`` or ``"h264_nvenc"``.
    encoder: str = "auto"
    #: Size of the rate control's buffer, in frames of average size. 1 gives packets of equal size; 15 to 30
    #: give better pictures, key frames of about three times the average and bursts.
    vbv_frames: float = 1.0

    def __post_init__(self) -> None:
        if min(self.width, self.height) < 2 or self.width % 2 or self.height % 2:
            raise CodecError(
                f"H.264 size: given {self.width} x {self.height}, allowed are even sides from 2"
            )
        if self.width * self.height > MAX_PIXELS:
            raise CodecError(
                f"H.264 size: {self.width} x {self.height} exceeds {MAX_PIXELS} pixels"
            )
        for name in ("fps", "bitrate_bps", "gop"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise CodecError(f"H.264 {name}: given {value}, allowed are positive numbers")
        if not 1 <= self.vbv_frames < math.inf:
            raise CodecError(
                f"H.264 vbv_frames: given {self.vbv_frames}, allowed are numbers from 1"
            )

    @property
    def vbv_bits(self) -> int:
        """Size of the rate control's buffer in bits."""
        return int(self.bitrate_bps / self.fps * self.vbv_frames)


TABLE_2 = H264Settings(width=640, height=360, fps=30, bitrate_bps=4_000_000, gop=30)
"""The camera stream of paper A, table 2; the encoder there is ``h264_nvmpi``, its buffer size is not stated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodedFrame:
    """One access unit of H.264."""

    data: bytes  #: Annex B bytes; key frames hold the parameter sets.
    pts: int  #: Number of the frame, from 0.
    is_key: bool  #: Whether a decoder may start here.


def _private_options(name: str, settings: H264Settings) -> dict[str, str]:
    """Return the encoder's own options for no look-ahead, forced IDR frames and constant rate."""
    if name == "libx264":
        # superfast keeps CABAC and the loop filter, as camera hardware does, so decoding costs what it does
        # in the field; ultrafast drops both and makes decoding three times cheaper than it really is.
        params = f"nal-hrd=cbr:scenecut=0:min-keyint={settings.gop}"
        return {
            "preset": "superfast",
            "tune": "zerolatency",
            "forced-idr": "1",
            "x264-params": params,
        }
    return {
        "h264_nvenc": {
            "tune": "ull",
            "zerolatency": "1",
            "delay": "0",
            "rc": "cbr",
            "forced-idr": "1",
        },
        "h264_qsv": {"async_depth": "1", "forced_idr": "1", "low_delay_brc": "1"},
        "h264_vaapi": {"async_depth": "1", "rc_mode": "CBR"},
        "h264_amf": {
            "usage": "ultralowlatency",
            "rc": "cbr",
            "forced_idr": "1",
            "filler_data": "1",
        },
    }.get(name, {})


def _context(name: str, mode: str) -> VideoCodecContext:
    context = av.CodecContext.create(name, "w" if mode == "w" else "r")
    if not isinstance(context, VideoCodecContext):
        raise CodecError(f"codec {name!r}: not a video codec")
    return context


class EncoderSession:
    """An FFmpeg encoder opened by name for a stream; av.FFmpegError, or ValueError for an unknown name."""

    def __init__(self, name: str, settings: H264Settings) -> None:
        context = _context(name, "w")
        formats = [entry.name for entry in context.codec.video_formats or ()]
        self._format = "yuv420p" if not formats or "yuv420p" in formats else "nv12"
        rate = Fraction(settings.fps).limit_denominator(1001)
        context.width, context.height, context.pix_fmt = (
            settings.width,
            settings.height,
            self._format,
        )
        context.framerate, context.time_base = rate, 1 / rate
        context.bit_rate, context.gop_size, context.max_b_frames = (
            settings.bitrate_bps,
            settings.gop,
            0,
        )
        context.color_range, context.colorspace = _RANGE, _MATRIX
        context.color_primaries = context.color_trc = _MATRIX
        context.thread_count = 1
        rate_bps = str(settings.bitrate_bps)
        context.options = {
            "maxrate": rate_bps,
            "minrate": rate_bps,
            "bufsize": str(settings.vbv_bits),
            **_private_options(name, settings),
        }
        context.open()
        self._context = context
        self._reformatter = VideoReformatter()
        self._shape = (settings.height, settings.width, 3)
        self._next_pts = 0

    def encode(
        self, image_bgr: NDArray[np.uint8], *, force_key: bool = False
    ) -> tuple[EncodedFrame, ...]:
        """Encode one image (height, width, 3), uint8, to the frames let go; CodecError if it does not fit."""
        if image_bgr.shape != self._shape or image_bgr.dtype != np.uint8:
            given = kind_of(image_bgr)
            raise CodecError(
                f"H.264 encoder: given {given}, allowed is uint8 of shape {self._shape}"
            )
        frame = self._planes(np.ascontiguousarray(image_bgr))
        frame.pts, frame.time_base = self._next_pts, self._context.time_base
        frame.pict_type = PictureType.I if force_key else PictureType.NONE
        self._next_pts += 1
        return tuple(
            EncodedFrame(data=bytes(packet), pts=packet.pts or 0, is_key=packet.is_keyframe)
            for packet in self._context.encode(frame)
        )

    def _planes(self, image_bgr: NDArray[np.uint8]) -> av.VideoFrame:
        # Accurate rounding halves the colour error; it costs the sender 0.3 ms and the receivers nothing.
        return self._reformatter.reformat(
            av.VideoFrame.from_numpy_buffer(image_bgr, "bgr24"),
            format=self._format,
            dst_colorspace=Colorspace.ITU601,
            dst_color_range=_RANGE,
            interpolation=Interpolation.BILINEAR | Interpolation.ACCURATE_RND,
            threads=1,
        )


class DecoderSession:
    """An FFmpeg decoder, opened by its name, for frames of at most so many pixels.

    Raises:
        av.FFmpegError: If FFmpeg cannot open it here.
        ValueError: If FFmpeg does not know it.
    """

    def __init__(self, name: str, most_pixels: int = MAX_PIXELS) -> None:
        context = _context(name, "r")
        # A second thread rarely pays below full HD, and never at 640 x 360.
        context.thread_type, context.thread_count = ThreadType.SLICE, 1
        context.flags |= Flags.low_delay
        context.options = {"max_pixels": str(most_pixels), "err_detect": "explode"}
        # Wrappers of hardware decoders do not all take the generic options; that is no reason to refuse them.
        context.open(strict=False)
        self._context = context
        self._reformatter = VideoReformatter()

    def decode(self, data: bytes) -> tuple[av.VideoFrame, ...]:
        """Feed one packet, not empty, and return the frames that come out; av.FFmpegError for a fault in it."""
        return tuple(self._context.decode(av.Packet(data)))

    def flush(self) -> None:
        """Forget all reference frames but not the parameter sets."""
        self._context.flush_buffers()

    def bgr(self, frame: av.VideoFrame) -> NDArray[np.uint8]:
        """Convert a decoded frame to BGR by the matrix and range that the stream names (BT.601 if none).

        Pixels have the shape (height, width, 3), uint8; rows may be padded, the memory is the caller's own. One
        reformatter, bilinear, one thread: a quarter or less of what ``frame.to_ndarray(format="bgr24")`` costs,
        which builds a new context each time. Raises av.FFmpegError where swscale cannot.
        """
        bgr = self._reformatter.reformat(
            frame, format="bgr24", interpolation=Interpolation.BILINEAR, threads=1
        )
        plane = bgr.planes[0]
        rows = np.frombuffer(cast("memoryview", plane), np.uint8).reshape(-1, plane.line_size)
        return rows[: frame.height, : 3 * frame.width].reshape(frame.height, frame.width, 3)


_H264_ENTRY = frozenset({5, 7})  # IDR slice, sequence parameter set
_H265_ENTRY = frozenset({*range(16, 24), 32, 33})  # IRAP slices, video and sequence parameter sets
_KEY_PICTURES = {"h264": frozenset({5}), "hevc": frozenset(range(16, 24))}  # IDR and IRAP slices


def has_start_code(data: bytes) -> bool:
    """Return whether the bytes start as Annex B demands, and not with a length as in MP4 files."""
    return data.startswith((b"\0\0\1", b"\0\0\0\1"))


def nal_unit_types(data: bytes, *, codec: str) -> Iterator[int]:
    """Yield each NAL unit's type, as tables 7-1 number them, in Annex B bytes of ``"h264"`` or ``"hevc"``."""
    at = data.find(b"\0\0\1")
    while 0 <= at < len(data) - 3:
        header = data[at + 3]
        yield header & 0x1F if codec == "h264" else header >> 1 & 0x3F
        at = data.find(b"\0\0\1", at + 3)


def is_entry_point(data: bytes, *, codec: str) -> bool:
    """Return whether a decoder may start here: at a slice without references, or parameter sets, sent apart."""
    wanted = _H264_ENTRY if codec == "h264" else _H265_ENTRY
    return any(kind in wanted for kind in nal_unit_types(data, codec=codec))


def holds_key_picture(data: bytes, *, codec: str) -> bool:
    """Return whether this access unit has a slice, and not parameter sets alone, with which one may start."""
    return any(kind in _KEY_PICTURES[codec] for kind in nal_unit_types(data, codec=codec))
