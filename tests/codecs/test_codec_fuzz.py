"""Hostile bytes into every door: an answer or a CodecError, never another error, and the next frame decodes.

A crash of a native library ends the test run itself.
"""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from sfglab import codecs
from sfglab.codecs import rvl
from sfglab.codecs.libav import nal_unit_types


def mutations(data: bytes, rng: np.random.Generator, count: int):
    """Yield truncations, flipped bits, overwritten stretches and noise, in turn."""
    for trial in range(count):
        changed = np.frombuffer(data, np.uint8).copy()
        place = int(rng.integers(len(changed)))
        match trial % 5:
            case 0:
                changed = changed[:place]
            case 1:
                changed[place] ^= 1 << rng.integers(8)
            case 2:
                changed[int(rng.integers(min(60, len(changed))))] ^= 1 << rng.integers(8)  # headers
            case 3:
                stretch = changed[place : place + 40]
                stretch[:] = rng.integers(0, 256, len(stretch))
            case 4:
                changed = rng.integers(0, 256, int(rng.integers(300)), np.uint8)
                changed[:4] = np.frombuffer(data, np.uint8)[: len(changed[:4])]
        yield changed.tobytes()


def survives(decode, data: bytes) -> bool:
    try:
        decode(data)
    except codecs.CodecError:
        return False
    return True


def test_hostile_depth_is_refused_or_an_image_and_never_written_outside_of_it():
    rng = np.random.default_rng(11)
    image = (rng.integers(900, 1100, (24, 31)) * (rng.random((24, 31)) < 0.8)).astype(np.uint16)
    guarded, refused = np.full((26, 31), 0xABCD, np.uint16), 0
    for hostile in mutations(rvl.encode(image), rng, 3000):
        words = np.frombuffer(hostile, "<u4", len(hostile) // 4)
        is_whole = rvl._decode_words(words, guarded[1:-1].reshape(-1))
        assert (guarded[[0, -1]] == 0xABCD).all()
        refused += not survives(partial(rvl.decode, shape=image.shape), hostile)
        assert is_whole or not survives(partial(rvl.decode, shape=image.shape), hostile)
    assert 1500 < refused < 3000


@pytest.mark.parametrize("codec", ["h264", "hevc"])
def test_video_messages_survive_noise_that_pretends_to_be_a_key_frame(codec):
    rng = np.random.default_rng(24)
    decoder = codecs.image_decoder(codecs.COMPRESSED_VIDEO)
    start = b"\0\0\0\1" + (b"\x67" if codec == "h264" else b"\x40\1")
    for _ in range(300):
        noise = rng.integers(0, 256, int(rng.integers(1, 200)), np.uint8).tobytes()
        survives(decoder.feed, SimpleNamespace(format=codec, data=start + noise))


def test_strings_survive(stream):
    rng = np.random.default_rng(25)
    fields = codecs.ffmpeg_packet_fields(stream[0], codecs.TABLE_2)
    decoder = codecs.image_decoder(codecs.FFMPEG_PACKET)
    for text in mutations(b"h264;yuv420p;bgr8;bgr8; compressedDepth rvl", rng, 300):
        name = text.decode("latin-1")
        codecs.parse_ffmpeg_encoding(name)
        survives(codecs.parse_depth_format, name)
        survives(decoder.feed, SimpleNamespace(encoding=name, pts=0, data=fields.data))
        list(nal_unit_types(text, codec="hevc"))


@pytest.mark.parametrize("codec", ["rvl", "png"])
def test_a_depth_picture_larger_than_announced_is_refused(codec):
    fields = codecs.compressed_depth_fields(np.zeros((1000, 1000), np.uint16), codec)
    assert codecs.image_decoder(codecs.COMPRESSED_IMAGE, most_pixels=10**6).feed(fields)
    with pytest.raises(codecs.CodecError, match="at most 999999 pixels"):
        codecs.image_decoder(codecs.COMPRESSED_IMAGE, most_pixels=10**6 - 1).feed(fields)
