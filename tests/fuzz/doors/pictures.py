"""Pictures: those of FFmpeg and of OpenCV."""

import struct
import zlib
from types import SimpleNamespace

import numpy as np

from doors import Door
from sfglab import codecs

COLOURS = np.arange(360 * 640 * 3, dtype=np.uint8).reshape(360, 640, 3)
DEPTH = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
ENCODER = codecs.H264Encoder(codecs.TABLE_2)
VIDEO, NEXT = (ENCODER.encode(one)[0].data for one in (COLOURS, COLOURS[::-1].copy()))
PNG = codecs.compressed_depth_fields(DEPTH, "png").data
JPEG = codecs.compressed_image_fields(COLOURS[:48, :64].copy()).data


def picture(kind, begin, *others, **fields):
    """One stream of a small announced size; after each input the next good one must show."""
    decoder = codecs.image_decoder(kind, most_pixels=640 * 360)
    good = SimpleNamespace(pts=1, **fields, data=begin)

    def read(data):
        try:
            decoder.feed(SimpleNamespace(pts=0, **fields, data=data))
        finally:
            assert decoder.feed(good)

    return Door(read, codecs.CodecError, (begin, *others))


def png(width, height):
    """A depth picture of zeros that is small as a file."""
    rows = zlib.compress(bytes(height * (2 * width + 1)), 9)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)),
        (b"IDAT", rows),
        (b"IEND", b""),
    )
    blocks = (
        struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in parts
    )
    return bytes(12) + b"\x89PNG\r\n\x1a\n" + b"".join(blocks)


DOORS = {
    "h264": picture(codecs.FFMPEG_PACKET, VIDEO, NEXT, encoding="h264"),
    "foxglove": picture(codecs.COMPRESSED_VIDEO, VIDEO, format="h264"),
    "png": picture(codecs.COMPRESSED_IMAGE, PNG, format="16UC1; compressedDepth png"),
    "jpeg": picture(codecs.COMPRESSED_IMAGE, JPEG, format="jpeg"),
}
ATTACKS = [("png", png(8000, 8000))]
