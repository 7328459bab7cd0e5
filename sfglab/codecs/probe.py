"""Probes of the H.264 encoders and decoders that really work on this machine.

FFmpeg's lists contain all compiled codecs, whether or not their hardware is present, and some codecs fail only at
the first frame. Therefore each candidate encodes or decodes three frames, which are counted and compared with the
originals. The result is kept until the process ends.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import av
import numpy as np

from sfglab.codecs.errors import CodecError, CodecUnavailableError
from sfglab.codecs.libav import H264Settings, VideoDecoder, VideoEncoder, why

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SOFTWARE_ENCODERS = ("libx264", "libopenh264")

ENCODERS = (
    "h264_nvmpi",
    "h264_nvenc",
    "h264_qsv",
    "h264_vaapi",
    "h264_amf",
    "h264_v4l2m2m",
    *_SOFTWARE_ENCODERS,
)
"""FFmpeg's H.264 encoders in order of preference: hardware, then software."""

DECODERS = ("h264_nvmpi", "h264_cuvid", "h264_qsv", "h264_v4l2m2m", "h264")
"""FFmpeg's H.264 decoders in order of preference: hardware, then software."""

SOFTWARE = frozenset({*_SOFTWARE_ENCODERS, "h264"})  #: Codecs that run on the processor.

_LOWEST_PSNR_DB = 25.0  # far below any working encoder at this rate, far above a wrong frame
_TRIAL = H264Settings(width=320, height=192, fps=30, bitrate_bps=2_000_000, gop=30)
_FAILURES = (av.FFmpegError, OSError, RuntimeError, ValueError)


@dataclass(frozen=True, slots=True, kw_only=True)
class CodecProbe:
    """Result of the trial of one encoder or decoder."""

    name: str  #: FFmpeg's name.
    #: Whether it encoded or decoded each trial frame without delay and in sufficient quality.
    works: bool
    reason: str  #: Cause of the failure, or the quality of the trial frames.

    @property
    def hardware(self) -> bool:
        """Whether the codec runs on hardware."""
        return self.name not in SOFTWARE


def available_encoders() -> tuple[CodecProbe, ...]:
    """Try all H.264 encoders, and return the results in order of preference."""
    return tuple(map(probe_encoder, ENCODERS))


def available_decoders() -> tuple[CodecProbe, ...]:
    """Try all H.264 decoders, and return the results in order of preference."""
    return tuple(map(probe_decoder, DECODERS))


@functools.cache
def probe_encoder(name: str) -> CodecProbe:
    """Try an encoder, by FFmpeg's name, once per process, and return the result.

    It encodes three frames, the last one as a forced key frame. The software decoder checks them.
    """
    return _verdict(name, encoder=name, decoder="h264")


@functools.cache
def probe_decoder(name: str) -> CodecProbe:
    """Try a decoder, by FFmpeg's name, on three frames of a software encoder, once per process."""
    for encoder in _SOFTWARE_ENCODERS:
        if probe_encoder(encoder).works:
            return _verdict(name, encoder=encoder, decoder=name)
    reason = "not tried: there is no software encoder to make a trial stream"
    return CodecProbe(name=name, works=False, reason=reason)


def choose_encoder(wanted: str) -> str:
    """Return FFmpeg's name of an H.264 encoder that works here.

    Args:
        wanted: ``"auto"`` for the first of `ENCODERS` that works, or the name of an encoder.

    Raises:
        CodecUnavailableError: The named encoder does not work here, or none does; the error has the causes.
    """
    failures = []
    for name in ENCODERS if wanted == "auto" else (wanted,):
        probe = probe_encoder(name)
        if probe.works:
            return name
        failures.append(f"{name}: {probe.reason}")
    reason = f"does not work here ({'; '.join(failures)}); `sfglab doctor` lists what does"
    raise CodecUnavailableError(wanted, reason=reason)


def choose_decoder() -> str:
    """Return FFmpeg's name of the first of `DECODERS` that works; the software decoder needs no trial."""
    for name in DECODERS:
        if name in SOFTWARE or probe_decoder(name).works:
            break
    return name


def _verdict(name: str, *, encoder: str, decoder: str) -> CodecProbe:
    try:
        worst_db = _worst_db(encoder, decoder)
    except _FAILURES as error:
        return CodecProbe(name=name, works=False, reason=why(error.__cause__ or error))
    reason = f"3 frames in, 3 out at once, {worst_db:.1f} dB; wanted are {_LOWEST_PSNR_DB} dB"
    return CodecProbe(name=name, works=worst_db >= _LOWEST_PSNR_DB, reason=reason)


def _worst_db(encoder: str, decoder: str) -> float:
    """Return the lowest PSNR, dB, of the trial frames, decoded as one stream and the last frame also alone."""
    images = _trial_images()
    opened = VideoEncoder(encoder, _TRIAL)
    packets = [opened.encode(image, force_key=image is images[2])[0] for image in images]
    if [packet.is_key for packet in packets] != [True, False, True]:
        raise CodecError("ignores a forced key frame")
    errors = []
    for start in (0, 2):
        reader = VideoDecoder("h264", decoder=decoder)
        for packet, image in zip(packets[start:], images[start:], strict=True):
            frames = reader.decode_bgr(packet.data)
            if len(frames) != 1:
                got = f"gave {len(frames)} frames for packet {packet.pts}"
                raise CodecError(f"{got}, wanted 1 at once")
            difference = frames[0].astype(np.float64) - image
            errors.append(float(np.mean(difference**2)))
    return 10 * math.log10(255**2 / max(*errors, 1e-9))


def _trial_images() -> list[NDArray[np.uint8]]:
    """Return three smooth images that differ, so that the PSNR reveals a repeated or missing one."""
    ramp = np.linspace(0, 255, _TRIAL.width).astype(np.uint8)
    row = np.stack([ramp, ramp[::-1], ramp // 2], axis=-1)
    image = np.broadcast_to(row, (_TRIAL.height, *row.shape))
    return [image // divisor for divisor in (1, 2, 3)]
