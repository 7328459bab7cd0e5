"""Probes of the H.264 encoders and decoders that really work on this machine.

FFmpeg's lists say what was compiled in, not what is there, and some codecs open and fail at the first frame;
so each candidate encodes or decodes three frames, and the frames are counted and compared. Verdicts hold for
the life of the process. Refuses to keep a stream's state (`sfglab.codecs.h264`).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import av
import numpy as np
from av.codec.codec import UnknownCodecError

from sfglab.codecs.errors import CodecError, CodecUnavailableError
from sfglab.codecs.libav import (
    DecoderSession,
    EncodedFrame,
    EncoderSession,
    H264Settings,
    has_start_code,
    is_entry_point,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

ENCODERS = (
    "h264_nvmpi",
    "h264_nvenc",
    "h264_qsv",
    "h264_vaapi",
    "h264_amf",
    "h264_v4l2m2m",
    "libx264",
    "libopenh264",
)
"""FFmpeg's H.264 encoders in order of preference: hardware, then software."""

DECODERS = ("h264_nvmpi", "h264_cuvid", "h264_qsv", "h264_v4l2m2m", "h264")
"""FFmpeg's H.264 decoders in order of preference: hardware, then software."""

SOFTWARE = frozenset({"libx264", "libopenh264", "h264"})  #: Codecs that run on the processor.

_LOWEST_PSNR_DB = 25.0  # far below any working encoder at this rate, far above a wrong picture
_TRIAL = H264Settings(width=320, height=192, fps=30, bitrate_bps=2_000_000, gop=30)
_FAILURES = (av.FFmpegError, OSError, RuntimeError, ValueError)


@dataclass(frozen=True, slots=True, kw_only=True)
class CodecProbe:
    """The verdict on one encoder or decoder."""

    name: str  #: FFmpeg's name.
    works: bool  #: Whether it encoded or decoded the trial frames at once and well.
    reason: str  #: Why not; or what was seen.

    @property
    def hardware(self) -> bool:
        """Whether it is a piece of hardware."""
        return self.name not in SOFTWARE


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The codec that was chosen."""

    name: str  #: FFmpeg's name.
    #: Why it is not a preferred one; None if nothing better was wanted.
    fallback_reason: str | None


def available_encoders() -> tuple[CodecProbe, ...]:
    """Try all H.264 encoders and return the verdicts in order of preference."""
    return tuple(probe_encoder(name) for name in ENCODERS)


def available_decoders() -> tuple[CodecProbe, ...]:
    """Try all H.264 decoders and return the verdicts in order of preference."""
    return tuple(probe_decoder(name) for name in DECODERS)


@functools.cache
def probe_encoder(name: str) -> CodecProbe:
    """Encode three frames, the last as a forced key frame, and check them with the software decoder."""
    return _verdict(name, lambda: _check_stream(_trial_stream(name), decoder="h264"))


@functools.cache
def probe_decoder(name: str) -> CodecProbe:
    """Decode three frames that a software encoder made."""
    maker = next(
        (found for found in ENCODERS if found in SOFTWARE and probe_encoder(found).works), None
    )
    if maker is None:
        reason = "not tried: there is no software encoder to make a trial stream"
        return CodecProbe(name=name, works=False, reason=reason)
    return _verdict(name, lambda: _check_stream(_trial_stream(maker), decoder=name))


def choose_encoder(wanted: str, *, fallback: bool) -> Choice:
    """Choose a working H.264 encoder by name or ``"auto"``, or software; else CodecUnavailableError."""
    software = [name for name in ENCODERS if name in SOFTWARE]
    names = ENCODERS if wanted == "auto" else [wanted, *(software if fallback else [])]
    return _first_working(wanted, (probe_encoder(name) for name in names))


def choose_decoder(wanted: str) -> Choice:
    """Choose an H.264 decoder: ``"auto"`` for the first of `DECODERS` that works, or a name.

    The software decoder is taken untried if nothing can make a trial stream for it. Raises
    CodecUnavailableError where the named one does not work.
    """
    if wanted == "h264":
        return Choice(name="h264", fallback_reason=None)
    if wanted != "auto":
        return _first_working(wanted, [probe_decoder(wanted)])
    hardware = [name for name in DECODERS if name not in SOFTWARE]
    working = CodecProbe(name="h264", works=True, reason="")
    return _first_working(wanted, [*(probe_decoder(name) for name in hardware), working])


def _first_working(wanted: str, probes: Iterable[CodecProbe]) -> Choice:
    failures: list[str] = []
    for probe in probes:
        if probe.works:
            return Choice(name=probe.name, fallback_reason="; ".join(failures) or None)
        failures.append(f"{probe.name}: {probe.reason}")
    reason = f"does not work here ({'; '.join(failures)}); `sfglab doctor` lists what does"
    raise CodecUnavailableError(wanted, reason=reason)


def why(error: Exception) -> str:
    """Return FFmpeg's reason without its call and options."""
    if isinstance(error, UnknownCodecError):
        return "not in this build of FFmpeg"
    if isinstance(error, av.FFmpegError):
        return f"{error.strerror} ({type(error).__name__})"
    return str(error)


def _verdict(name: str, trial: Callable[[], str]) -> CodecProbe:
    try:
        reason, works = trial(), True
    except _FAILURES as error:
        reason, works = why(error), False
    return CodecProbe(name=name, works=works, reason=reason)


def _trial_images() -> list[NDArray[np.uint8]]:
    """Return three smooth images that differ, so that a repeated or missing one shows."""
    rows, columns = np.mgrid[0 : _TRIAL.height, 0 : _TRIAL.width]
    return [
        np.stack([rows + 20 * shift, columns * 0.6 + 10 * shift, 200 - rows], axis=-1)
        .clip(0, 255)
        .astype(np.uint8)
        for shift in range(3)
    ]


def _trial_stream(encoder: str) -> list[EncodedFrame]:
    session = EncoderSession(encoder, _TRIAL)
    stream: list[EncodedFrame] = []
    for index, image in enumerate(_trial_images()):
        frames = session.encode(image, force_key=index == 2)
        if len(frames) != 1:
            raise CodecError(f"gave {len(frames)} packets for frame {index}, wanted 1 at once")
        stream += frames
    if [frame.is_key for frame in stream] != [True, False, True]:
        raise CodecError("ignores a forced key frame")
    if not all(has_start_code(frame.data) for frame in stream):
        raise CodecError("does not write Annex B")
    return stream


def _check_stream(stream: list[EncodedFrame], *, decoder: str) -> str:
    """Decode the whole stream, then its last frame alone, and return what was seen."""
    images = _trial_images()
    worst_db = min(
        _worst_db(DecoderSession(decoder), stream, images),
        _worst_db(DecoderSession(decoder), stream[2:], images[2:]),
    )
    if worst_db < _LOWEST_PSNR_DB:
        raise CodecError(f"pictures differ: {worst_db:.1f} dB, wanted {_LOWEST_PSNR_DB} dB")
    if not is_entry_point(stream[2].data, codec="h264"):
        raise CodecError("a key frame holds no IDR slice and no parameter sets")
    return f"3 frames in, 3 out at once, {worst_db:.1f} dB"


def _worst_db(
    session: DecoderSession, stream: list[EncodedFrame], images: list[NDArray[np.uint8]]
) -> float:
    worst_db = math.inf
    for encoded, image in zip(stream, images, strict=True):
        frames = session.decode(encoded.data)
        if len(frames) != 1:
            raise CodecError(
                f"gave {len(frames)} frames for packet {encoded.pts}, wanted 1 at once"
            )
        error = float(np.mean((session.bgr(frames[0]).astype(np.float64) - image) ** 2))
        worst_db = min(worst_db, 10 * math.log10(255**2 / max(error, 1e-9)))
    return worst_db
