"""H.264 encoders and decoders that work on this machine, hardware first."""

from __future__ import annotations

from sfglab.codecs.errors import MAX_PIXELS
from sfglab.codecs.libav import TABLE_2, H264Settings, VideoDecoder, VideoEncoder
from sfglab.codecs.probe import choose_decoder, choose_encoder


class H264Encoder(VideoEncoder):
    """An encoder of one stream; CodecUnavailableError where none works."""

    def __init__(self, settings: H264Settings = TABLE_2) -> None:
        super().__init__(choose_encoder(settings.encoder), settings)


class H264Decoder(VideoDecoder):
    """A decoder of one stream, by hardware where that works."""

    def __init__(self, *, most_pixels: int = MAX_PIXELS) -> None:
        super().__init__("h264", decoder=choose_decoder(), most_pixels=most_pixels)
