"""H.264 without delay: each image gives one packet at once, each packet one image at once.

Knows a stream's state: which encoder was taken and why, and whether the decoder has seen a key frame.
Refuses to know messages (`sfglab.codecs.carriers`) and clocks.

Source: paper A, section 4.3 and table 2.
"""

from __future__ import annotations

import functools
import logging
import time
from contextlib import suppress
from hashlib import sha256
from typing import TYPE_CHECKING, NoReturn

import av
import numpy as np

from sfglab.codecs.errors import (
    MAX_PIXELS,
    BitstreamError,
    CodecError,
    CodecUnavailableError,
    kind_of,
)
from sfglab.codecs.libav import (
    TABLE_2,
    DecoderSession,
    EncodedFrame,
    EncoderSession,
    H264Settings,
    has_start_code,
    holds_key_picture,
    is_entry_point,
)
from sfglab.codecs.probe import choose_decoder, choose_encoder, why
from sfglab.errors import InvalidValueError
from sfglab.files import own_folder

if TYPE_CHECKING:
    from numpy.typing import NDArray

_log = logging.getLogger(__name__)
_DAY_S = 86400.0


@functools.cache
def _say_once(message: str) -> None:
    """Log a warning, once a day for this user; each stream, process and command makes the same choice."""
    with suppress(OSError, InvalidValueError):
        said = own_folder() / f"said-{sha256(message.encode()).hexdigest()[:16]}"
        if said.exists() and 0 <= time.time() - said.stat().st_mtime < _DAY_S:
            return
        said.touch()
    _log.warning(message)


class H264Encoder:
    """An encoder for one stream, by `fallback` also in software; CodecUnavailableError where none works."""

    def __init__(self, settings: H264Settings = TABLE_2, *, fallback: bool = False) -> None:
        choice = choose_encoder(settings.encoder, fallback=fallback)
        self.settings = settings  #: As given.
        self.encoder_name = choice.name  #: The FFmpeg encoder that was opened.
        #: Why it is not a preferred one, else None; also logged as a warning, once a day.
        self.fallback_reason = choice.fallback_reason
        if choice.fallback_reason is not None:
            _say_once(f"H.264 is encoded by {choice.name}, because {choice.fallback_reason}")
        try:
            self._session = EncoderSession(choice.name, settings)
        except (av.FFmpegError, ValueError) as error:
            raise CodecError(
                f"H.264 encoder {choice.name!r} refuses {settings}: {why(error)}"
            ) from error

    def encode(
        self, image_bgr: NDArray[np.uint8], *, force_key: bool = False
    ) -> tuple[EncodedFrame, ...]:
        """Encode one image (height, width, 3), BGR, uint8, into exactly one frame.

        With `force_key` it is a key frame out of turn; the next regular one comes a GOP later. Raises
        CodecError where the image does not fit the settings, or the encoder keeps it back or fails.
        """
        try:
            frames = self._session.encode(image_bgr, force_key=force_key)
        except av.FFmpegError as error:
            raise CodecError(f"H.264 encoder {self.encoder_name!r} failed: {why(error)}") from error
        if len(frames) != 1:
            raise CodecError(
                f"H.264 encoder {self.encoder_name!r} gave {len(frames)} frames for one image"
            )
        return frames


class VideoDecoder:
    """A decoder for one H.264 or H.265 stream that joins, and joins again after a fault, at a key frame.

    A packet that went missing is not noticed here: libavcodec goes on from the wrong reference and marks
    nothing until the next key frame. Whoever can count packets should (`sfglab.codecs.carriers` does). The
    codec is ``"h264"`` or ``"hevc"``, the decoder FFmpeg's name; CodecError where it cannot be opened.
    """

    def __init__(self, codec: str, *, decoder: str, most_pixels: int = MAX_PIXELS) -> None:
        self.codec = codec  #: As given.
        self.decoder_name = decoder  #: The FFmpeg decoder that was opened.
        #: Whether a key frame is still awaited, and other packets are of no use.
        self.waiting = True
        self.refused_packets = 0  #: Packets passed over while waiting for a key frame.
        self.broken_packets = 0  #: Packets in which a fault was found.
        self._most_pixels = most_pixels
        try:
            self._session = DecoderSession(decoder, most_pixels)
        except (av.FFmpegError, ValueError) as error:
            raise CodecError(f"decoder {decoder!r} cannot be opened: {why(error)}") from error

    def decode(self, data: bytes) -> tuple[av.VideoFrame, ...]:
        """Decode one packet, an access unit in Annex B, to its frame.

        There is none while waiting for a key frame or for a packet of parameter sets alone. Raises
        BitstreamError where the packet is broken; the decoder then waits for the next key frame.
        """
        if not has_start_code(data):
            self._fail(data, "no Annex B start code (0 0 1 or 0 0 0 1) in front")
        if self.waiting and not is_entry_point(data, codec=self.codec):
            self.refused_packets += 1
            return ()
        try:
            frames = self._session.decode(data)
            if not frames and holds_key_picture(data, codec=self.codec):
                # An earlier packet made libavcodec expect pictures out of order: it would lag from now on.
                self._session = DecoderSession(self.decoder_name, self._most_pixels)
                frames = self._session.decode(data)
        except av.FFmpegError as error:
            self._fail(data, f"libavcodec: {why(error)}")
        if any(frame.is_corrupt for frame in frames):
            self._fail(data, "slices are damaged")
        self.waiting &= not frames
        return frames

    def decode_bgr(
        self, data: bytes, out: NDArray[np.uint8] | None = None
    ) -> tuple[NDArray[np.uint8], ...]:
        """Decode one packet to BGR pixels, by the colour matrix and range that the stream names; see `decode`.

        They are contiguous arrays (height, width, 3), uint8: `out` or new memory; a stream may change its
        size.

        Raises:
            BitstreamError: As `decode`.
            CodecError: As `bgr`.
        """
        return tuple(self.bgr(frame, out) for frame in self.decode(data))

    def bgr(self, frame: av.VideoFrame, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """Convert a frame to BGR (height, width, 3), uint8, in a fitting `out` or new; or CodecError."""
        try:
            pixels = self._session.bgr(frame)
        except (av.FFmpegError, ValueError) as error:
            raise CodecUnavailableError(
                frame.format.name, reason=f"not convertible: {why(error)}"
            ) from error
        if out is None:
            return np.ascontiguousarray(pixels)
        if out.shape != pixels.shape or out.dtype != np.uint8:
            both = f"the frame is {kind_of(pixels)}; given for it is {kind_of(out)}"
            raise CodecError(f"decoded pixels: {both}")
        np.copyto(out, pixels)
        return out

    def reset(self) -> None:
        """Forget the stream: wait for a key frame again."""
        self._session.flush()
        self.waiting = True

    def _fail(self, data: bytes, reason: str) -> NoReturn:
        self.broken_packets += 1
        self.reset()
        raise BitstreamError(self.codec, reason=reason, size_bytes=len(data))


class H264Decoder(VideoDecoder):
    """An H.264 decoder by name, or ``"auto"``: what works, hardware first; else CodecUnavailableError."""

    def __init__(self, decoder: str = "auto", *, most_pixels: int = MAX_PIXELS) -> None:
        super().__init__("h264", decoder=choose_decoder(decoder).name, most_pixels=most_pixels)
