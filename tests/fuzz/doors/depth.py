"""Depth pictures of the codec that is compiled."""

import struct

from doors.pictures import DEPTH, picture
from sfglab import codecs

RVL = codecs.compressed_depth_fields(DEPTH, "rvl").data
DOORS = {"rvl": picture(codecs.COMPRESSED_IMAGE, RVL, format="16UC1; compressedDepth rvl")}
ATTACKS = [("rvl", bytes(12) + struct.pack("<II", 8192, 8192) + bytes(8))]
