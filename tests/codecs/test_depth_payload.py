import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfglab import codecs
from sfglab.codecs import CodecError, DepthFormat, decode_depth, encode_depth

HOLE_STEP_PLANE = np.array([[0, 0, 5, 6, 6]], np.uint16)
WORD = bytes.fromhex("0020a123")  # worked by hand in test_rvl.py
COLOURS = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1].tobytes()
A, B = 10100.0, -1009.0  # 100 * 101, and 1 - A / 10


def test_a_payload_is_a_header_and_columns_rows_words_or_a_file():
    depth_format, data = encode_depth(HOLE_STEP_PLANE)
    assert str(depth_format) == "16UC1; compressedDepth rvl"
    assert data == struct.pack("<iff", 0, 0.0, 0.0) + struct.pack("<II", 5, 1) + WORD
    depth_format, data = encode_depth(HOLE_STEP_PLANE, codec="png", png_level=1)
    assert str(depth_format) == "16UC1; compressedDepth png"
    assert data[:12] == bytes(12)
    picture = cv2.imdecode(np.frombuffer(data[12:], np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.dtype == np.uint16
    assert np.array_equal(picture, HOLE_STEP_PLANE)


@given(
    hnp.arrays(np.uint16, st.tuples(st.integers(1, 9), st.integers(1, 40))),
    st.sampled_from(["rvl", "png"]),
)
@settings(max_examples=100, deadline=None)
def test_16_bit_depth_comes_back_bit_by_bit_however_far(depth, codec):
    depth_format, data = encode_depth(depth, codec=codec, png_level=1)
    back, encoding = decode_depth(data, depth_format)
    assert encoding == "16UC1"
    assert back.dtype == np.uint16
    assert np.array_equal(back, depth)


def test_another_range_of_32_bit_depth_is_honoured():
    metres = np.array([[3.0, 5.5, 19.0]], np.float32)
    quantised = (10100 / metres - 504).astype(np.uint16)  # depth_max of 20 m
    _, data = encode_depth(quantised)
    data = struct.pack("<iff", 0, 10100.0, -504.0) + data[12:]
    depth, _ = decode_depth(data, DepthFormat(encoding="32FC1", codec="rvl"))
    np.testing.assert_allclose(depth, metres, rtol=0.04)


def quantised(values, codec="rvl"):
    """A payload as the plugin makes it of 32-bit depth, with its own A and B."""
    _, data = encode_depth(np.array([values], np.uint16), codec=codec, png_level=1)
    return struct.pack("<iff", 0, A, B) + data[12:]


@pytest.mark.parametrize("codec", ["rvl", "png"])
def test_32_bit_depth_is_read_as_the_plugin_does_it(codec):
    # The plugin's whole part of A / d + B, and A / (q - B), for 1, 2, 0.16 and 9.99 m and a hole.
    data = quantised([9091, 4041, 62116, 2, 0], codec)
    depth, encoding = decode_depth(data, DepthFormat(encoding="32FC1", codec=codec))
    assert (encoding, depth.dtype) == ("32FC1", np.float32)
    wanted = [[1.0, 2.0, 10100 / 63125, 10100 / 1011, np.nan]]
    np.testing.assert_allclose(depth, wanted, rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "encoding", "codec"),
    [
        ("16UC1; compressedDepth rvl", "16UC1", "rvl"),
        ("16UC1; compressedDepth png", "16UC1", "png"),
        ("16UC1; compressedDepth", "16UC1", "png"),
        ("32FC1; compressedDepth RVL", "32FC1", "rvl"),
        ("mono16;compresseddepth rvl", "mono16", "rvl"),
        ("compressedDepth", "", "png"),
    ],
)
def test_format_strings_old_and_new_are_read(text, encoding, codec):
    assert codecs.parse_depth_format(text) == DepthFormat(encoding=encoding, codec=codec)


@pytest.mark.parametrize(
    "text", ["", "jpeg", "16UC1; compressedDepth med", "16UC1; compressedDepth rvl 2", "16UC1;"]
)
def test_other_format_strings_are_refused(text):
    with pytest.raises(CodecError, match="compressedDepth"):
        codecs.parse_depth_format(text)


def test_without_an_encoding_the_header_tells_whether_it_was_quantised_and_a_16_bit_name_is_kept():
    _, plain = encode_depth(HOLE_STEP_PLANE)
    for data, named, wanted in (
        (plain, "", "16UC1"),
        (quantised([4041]), "", "32FC1"),
        (plain, "mono16", "mono16"),
    ):
        assert decode_depth(data, DepthFormat(encoding=named, codec="rvl"))[1] == wanted


@pytest.mark.parametrize(
    ("encoding", "codec", "data", "fault"),
    [
        ("16UC1", "rvl", b"", "header"),
        ("16UC1", "png", bytes(12), "header"),
        ("16UC1", "rvl", bytes(12) + bytes(7), "image size"),
        ("16UC1", "rvl", bytes(12) + struct.pack("<II", 0, 5) + WORD, "0 x 5"),
        ("16UC1", "rvl", bytes(12) + struct.pack("<II", 2**31, 2**31) + WORD, "claims"),
        ("16UC1", "rvl", bytes(12) + struct.pack("<II", 5, 2) + WORD, "no words of one image"),
        ("16UC1", "png", bytes(12) + b"no png", "neither"),
        ("16UC1", "png", bytes(12) + COLOURS, "one channel of 16 bits"),
        ("32FC1", "rvl", bytes(12) + struct.pack("<II", 5, 1) + WORD, "A = 0.0"),
        ("32FC1", "rvl", struct.pack("<iffII", 0, np.nan, 0, 5, 1) + WORD, "A = nan"),
        ("32FC1", "rvl", struct.pack("<iffII", 0, 1, np.inf, 5, 1) + WORD, "B = inf"),
    ],
)
def test_faulty_payloads_are_refused_with_the_reason(encoding, codec, data, fault):
    with pytest.raises(codecs.BitstreamError, match=fault):
        decode_depth(data, DepthFormat(encoding=encoding, codec=codec))


def test_a_format_of_another_codec_is_refused_before_the_payload_is_read():
    data = bytes(12) + struct.pack("<II", 5, 1) + WORD
    with pytest.raises(CodecError, match="given 'med', allowed: 'png', 'rvl'"):
        decode_depth(data, DepthFormat(encoding="16UC1", codec="med"))


def test_hostile_quantisers_give_numbers_and_no_warning():
    data = struct.pack("<iffII", 0, 1e-45, 5.0, 5, 1) + WORD
    depth, _ = decode_depth(data, DepthFormat(encoding="32FC1", codec="rvl"))
    assert depth.shape == (1, 5)


@pytest.mark.parametrize(
    ("depth", "options", "fault"),
    [
        (np.zeros((2, 2), "f4"), {}, "uint16 of two"),
        (np.zeros((2, 2, 1), "u2"), {}, "uint16 of two"),
        (np.zeros((2, 2), "u2"), {"codec": "zstd"}, "'zstd'"),
        (np.zeros((0, 2), "u2"), {}, "not empty"),
    ],
)
def test_other_images_and_options_are_refused(depth, options, fault):
    with pytest.raises(CodecError, match=fault):
        encode_depth(depth, **options)
