"""Depth pictures of the codecs that are compiled."""

import struct

import zstandard

from doors.pictures import DEPTH, picture
from sfglab import codecs

RVL, MED = (codecs.compressed_depth_fields(DEPTH, codec).data for codec in ("rvl", "med"))


def packed(byte, size):
    """So many equal bytes by Zstandard, made piece by piece."""
    made = zstandard.ZstdCompressor().compressobj(size=size)
    return b"".join(made.compress(2**20 * byte) for _ in range(size // 2**20)) + made.flush()


DOORS = {
    "rvl": picture(codecs.COMPRESSED_IMAGE, RVL, format="16UC1; compressedDepth rvl"),
    "med": picture(codecs.COMPRESSED_IMAGE, MED, format="16UC1; compressedDepth med"),
}
ATTACKS = [
    ("rvl", bytes(12) + struct.pack("<II", 8192, 8192) + bytes(8)),
    *(
        ("med", bytes(12) + struct.pack("<II", 8192, 8192) + packed(byte, size))
        for byte, size in ((b"\0", 2**26), (b"\0", 2**27), (b"\xff", 2**26))
    ),
]
