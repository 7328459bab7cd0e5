import struct
import zlib

import numpy as np
import pytest

from sfglab.codecs import BitstreamError, CodecError
from sfglab.codecs.still import decode_still, encode_jpeg, encode_png


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (5, 7, 4), (1, 1), (1, 33)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_png_is_lossless_for_all_it_can_hold(shape, dtype):
    picture = np.random.default_rng(2).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)
    picture[0, 0] = np.iinfo(dtype).max  # also in the alpha channel
    assert np.array_equal(decode_still(encode_png(picture, level=3)), picture)


def test_jpeg_comes_close_and_grey_stays_grey(pictures):
    picture = pictures[3][:48, :64]
    assert np.abs(decode_still(encode_jpeg(picture)).astype(int) - picture).mean() < 6
    assert decode_still(encode_jpeg(picture[:, :, 0])).shape == (48, 64)


def png_claiming(width: int, height: int) -> bytes:
    chunk = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    end = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))
    return (
        b"\x89PNG\r\n\x1a\n"
        + struct.pack(">I", 13)
        + chunk
        + struct.pack(">I", zlib.crc32(chunk))
        + end
    )


def jpeg_claiming(width: int, height: int) -> bytes:
    # start, a comment segment, a fill byte, start of frame (baseline)
    return b"\xff\xd8\xff\xfe\0\4hi\xff\xff\xc0\0\x0b\x08" + struct.pack(">HH", height, width)


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (png_claiming(2**31 - 1, 2**31 - 1), "2147483647 x 2147483647"),
        (jpeg_claiming(65535, 65534), "65535 x 65534"),
        (b"", "nothing"),
        (b"GIF89a", "47 49 46"),
        (b"\xff\xd8", "no start of frame"),
        (b"\xff\xd8\xff\xda\0\2" + bytes(50), "no start of frame"),
        (png_claiming(5, 5), "cut or damaged"),
        (png_claiming(5, 5)[:40], "passes the end"),
        (png_claiming(5, 5)[:33] + b"\xff\0\0\0IDAT" + png_claiming(5, 5)[33:], "passes the end"),
        (jpeg_claiming(5, 5), "cut or damaged"),
    ],
)
def test_what_is_no_picture_and_a_bomb_by_its_header_are_refused(data, fault):
    with pytest.raises(BitstreamError, match=fault):
        decode_still(data)


def test_an_array_that_no_picture_holds_is_refused():
    with pytest.raises(CodecError, match="cannot hold uint8"):
        encode_png(np.zeros((4, 4, 5), np.uint8), level=3)
