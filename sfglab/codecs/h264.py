"""H.264 encoders and decoders that work on this machine, hardware first."""

from __future__ import annotations

from sfglab.codecs.errors import MAX_PIXELS
from sfglab.codecs.libav import TABLE_2, H264Settings, VideoDecoder, VideoEncoder
from sfglab.codecs.probe import choose_decoder, choose_encoder


class H264Encoder(VideoEncoder):
    """An H.264 encoder of one stream, on hardware where that works.

    Raises:
        CodecUnavailableError: No encoder works here, or not the one that the settings name.
        CodecError: The encoder refuses the settings.
    """

    def __init__(self, settings: H264Settings = TABLE_2) -> None:
        super().__init__(choose_encoder(settings.encoder), settings)


class H264Decoder(VideoDecoder):
    """An H.264 decoder of one stream, on hardware where that works; see `VideoDecoder`.

    Raises:
        CodecError: The decoder cannot be opened.
    """

    def __init__(self, *, most_pixels: int = MAX_PIXELS) -> None:
        super().__init__("h264", decoder=choose_decoder(), most_pixels=most_pixels)
