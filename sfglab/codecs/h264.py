"""H.264 encoders and decoders that work on this machine, hardware first."""

from __future__ import annotations

import functools
import logging
import time
from contextlib import suppress
from hashlib import sha256

from sfglab.codecs.errors import MAX_PIXELS
from sfglab.codecs.libav import TABLE_2, H264Settings, VideoDecoder, VideoEncoder
from sfglab.codecs.probe import choose_decoder, choose_encoder
from sfglab.errors import InvalidValueError
from sfglab.files import own_folder

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


class H264Encoder(VideoEncoder):
    """An encoder of one stream, with `fallback` also in software; CodecUnavailableError where none works."""

    def __init__(self, settings: H264Settings = TABLE_2, *, fallback: bool = False) -> None:
        #: Why a preferred encoder does not work, otherwise None; also logged as a warning, once a day.
        name, self.fallback_reason = choose_encoder(settings.encoder, fallback=fallback)
        if self.fallback_reason is not None:
            _say_once(f"H.264 is encoded by {name}, because {self.fallback_reason}")
        super().__init__(name, settings)


class H264Decoder(VideoDecoder):
    """A decoder by name, or ``"auto"``: the first that works; CodecUnavailableError where it does not."""

    def __init__(self, decoder: str = "auto", *, most_pixels: int = MAX_PIXELS) -> None:
        super().__init__("h264", decoder=choose_decoder(decoder), most_pixels=most_pixels)
