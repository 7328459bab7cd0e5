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


# metres, the plugin's 16-bit value, and what comes back: whole part of A / d + B, then A / (q - B)
QUANTISED = [
    (1.0, 9091, 1.0),
    (2.0, 4041, 2.0),
    (0.16, 62116, 10100 / 63125),
    (9.99, 2, 10100 / 1011),
    (0.15, 0, np.nan),  # 66324 does not fit; the plugin's cast is undefined there
    *((nowhere_m, 0, np.nan) for nowhere_m in (10.0, 11.0, 0.0, -1.0, np.nan, np.inf)),
]


@pytest.mark.parametrize("codec", ["rvl", "png"])
def test_32_bit_depth_is_quantised_as_the_plugin_does_it(codec):
    metres, quantised, back = (
        np.array([column], np.float32) for column in zip(*QUANTISED, strict=True)
    )
    depth_format, data = encode_depth(metres, codec=codec)
    assert str(depth_format) == f"32FC1; compressedDepth {codec}"
    assert data[:12] == struct.pack("<iff", 0, A, B)
    as_16_bit, _ = decode_depth(data, DepthFormat(encoding="16UC1", codec=codec))
    assert as_16_bit.tolist() == quantised.astype(int).tolist()
    depth, encoding = decode_depth(data, depth_format)
    assert encoding == "32FC1"
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, back, rtol=1e-6)


@given(hnp.arrays(np.float32, (3, 11), elements=st.floats(0.1875, 9.875, width=32)))
@settings(max_examples=100, deadline=None)
def test_32_bit_depth_errs_by_less_than_a_step_and_not_twice(metres):
    depth_format, data = encode_depth(metres)
    once, _ = decode_depth(data, depth_format)
    step = metres.astype(float) ** 2 / A  # derivative of A / q
    assert (np.abs(once - metres) <= 1.2 * step + 1e-6).all()


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
    (_, plain), (_, quantised) = (
        encode_depth(HOLE_STEP_PLANE),
        encode_depth(np.ones((1, 3), np.float32)),
    )
    for data, named, wanted in (
        (plain, "", "16UC1"),
        (quantised, "", "32FC1"),
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
    with pytest.raises(CodecError, match="given 'med', allowed are 'png' or 'rvl'"):
        decode_depth(data, DepthFormat(encoding="16UC1", codec="med"))


def test_hostile_quantisers_give_numbers_and_no_warning():
    data = struct.pack("<iffII", 0, 1e-45, 5.0, 5, 1) + WORD
    depth, _ = decode_depth(data, DepthFormat(encoding="32FC1", codec="rvl"))
    assert depth.shape == (1, 5)


@pytest.mark.parametrize(
    ("depth", "options", "fault"),
    [
        (np.zeros((2, 2), "u1"), {}, "uint16 and float32"),
        (np.zeros((2, 2, 1), "u2"), {}, "uint16 and float32"),
        (np.zeros((2, 2), "f8"), {}, "uint16 and float32"),
        (np.zeros((2, 2), "u2"), {"codec": "zstd"}, "'zstd'"),
        (np.zeros((0, 2), "u2"), {}, "not empty"),
    ],
)
def test_other_images_and_options_are_refused(depth, options, fault):
    with pytest.raises(CodecError, match=fault):
        encode_depth(depth, **options)
