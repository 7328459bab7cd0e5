"""H.264 and RVL, and the ROS messages that carry them (paper A, section 4.3).

The package has functions and values, but neither nodes nor message classes. `sfglab.codecs.rvl` compiles
code when it is imported, which happens with the first depth image. A caller that cannot wait then imports
it earlier.
"""

from sfglab.codecs.carriers import (
    COMPRESSED_IMAGE,
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    compressed_depth_fields,
    compressed_image_fields,
    ffmpeg_packet_fields,
    image_decoder,
    parse_ffmpeg_encoding,
)
from sfglab.codecs.depth import DepthFormat, decode_depth, encode_depth, parse_depth_format
from sfglab.codecs.errors import MAX_PIXELS, BitstreamError, CodecError, CodecUnavailableError
from sfglab.codecs.h264 import H264Decoder, H264Encoder
from sfglab.codecs.libav import TABLE_2, EncodedPacket, H264Settings
from sfglab.codecs.probe import CodecProbe, available_decoders, available_encoders

__all__ = [
    "COMPRESSED_IMAGE",
    "COMPRESSED_VIDEO",
    "FFMPEG_PACKET",
    "MAX_PIXELS",
    "TABLE_2",
    "BitstreamError",
    "CodecError",
    "CodecProbe",
    "CodecUnavailableError",
    "DepthFormat",
    "EncodedPacket",
    "H264Decoder",
    "H264Encoder",
    "H264Settings",
    "available_decoders",
    "available_encoders",
    "compressed_depth_fields",
    "compressed_image_fields",
    "decode_depth",
    "encode_depth",
    "ffmpeg_packet_fields",
    "image_decoder",
    "parse_depth_format",
    "parse_ffmpeg_encoding",
]
