import subprocess
import sys

import numpy as np
import pytest
import rvl_reference
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfglab.codecs import MAX_PIXELS, BitstreamError, rvl


def words(*numbers: int) -> bytes:
    """Pack numbers as RVL does, by text: octal digits from the right, each with its bit 'more follow'."""
    nibbles = []
    for number in numbers:
        digits = [int(digit) for digit in reversed(f"{number:o}")]
        nibbles += [digit + 8 for digit in digits[:-1]] + [digits[-1]]
    text = "".join(f"{nibble:x}" for nibble in nibbles)
    text += "0" * (-len(text) % 8)
    return b"".join(bytes.fromhex(text[at : at + 8])[::-1] for at in range(0, len(text), 8))


def reference_bytes(depth: np.ndarray) -> bytes:
    """The words of the plain reference, which reads what it writes."""
    nibbles, back = np.zeros(8 * depth.size + 8, np.uint8), np.full(depth.size, 9, np.uint16)
    count = rvl_reference.encode_nibbles(depth.reshape(-1), nibbles)
    read = rvl_reference.decode_nibbles(nibbles, back)
    assert np.array_equal(back, depth.reshape(-1))
    assert count - read in (0, 1)  # the run of no non-zeros that may end an image need not be read
    eights = nibbles[: count + -count % 8].reshape(-1, 8).astype(np.uint32)
    shifts = np.arange(28, -1, -4, dtype=np.uint32)
    return (eights << shifts).sum(axis=1, dtype=np.uint32).astype("<u4").tobytes()


GOLDEN = {
    # zeros 2; non-zeros 3; +5 is 10, octal 12: nibbles a 1; +1 is 2; 0 is 0: 23a120 and padding, low byte first
    "a hole, a step and a plane": ([[0, 0, 5, 6, 6]], "0020a123"),
    # zeros 0; one: +7 is 14, octal 16: e 1; zeros 1; one: -1 to the pixel before the hole is 1: 01e1111
    "differences run on across a hole": ([[7, 0, 6]], "1011e101"),
    # zeros 6, none else: 60
    "nothing but holes": ([[0, 0, 0], [0, 0, 0]], "00000060"),
    # 0 3, then 131070, 131067, 131068, octal 377776, 377773, 377774: six nibbles each
    "the largest differences": ([[65535, 1, 65535]], "f3ffef03cff3ffbf0000f3ff"),
    # eight nibbles exactly fill the word: zeros 0, ones 6, +1 is 2, then 0 five times
    "a word without padding": ([[1, 1, 1, 1, 1, 1]], "00002006"),
}


@pytest.mark.parametrize(("depth", "expected"), GOLDEN.values(), ids=GOLDEN)
def test_hand_worked_bytes(depth, expected):
    image = np.array(depth, np.uint16)
    assert rvl.encode(image).hex() == expected
    assert rvl.decode(bytes.fromhex(expected), image.shape).tolist() == depth


pixel = st.one_of(
    st.just(0), st.integers(1, 9), st.integers(0, 65535), st.sampled_from([1, 0xFFFF])
)
depth_images = hnp.arrays(
    np.uint16,
    st.tuples(st.integers(1, 7), st.integers(1, 33)),
    elements=pixel,
    fill=st.sampled_from([0, 5]),
)


@given(depth_images)
@settings(max_examples=300, deadline=None)
def test_words_equal_the_plain_reference_and_decode_to_the_image(image):
    data = rvl.encode(image)
    assert data == reference_bytes(image)
    assert np.array_equal(rvl.decode(data, image.shape), image)


@pytest.mark.parametrize("shape", [(1, 1), (1, 640), (480, 1), (3, 5), (360, 640)])
def test_worst_case_fits_and_is_about_one_and_a_half_times_raw(shape):
    image = np.full(shape, 0xFFFF, np.uint16)
    image.reshape(-1)[1::2] = 1
    data = rvl.encode(image)
    assert len(data) <= 1.5 * image.nbytes + 8
    assert np.array_equal(rvl.decode(data, shape), image)


def test_views_copies_and_foreign_byte_order_encode_alike():
    image = np.arange(48, dtype=np.uint16).reshape(6, 8)
    expected = rvl.encode(image)
    wide = np.zeros((6, 16), np.uint16)
    wide[:, ::2] = image
    unaligned = np.frombuffer(b"\0" + image.tobytes(), np.uint8)[1:].view(np.uint16).reshape(6, 8)
    fixed = image.copy()
    fixed.flags.writeable = False
    for other in (wide[:, ::2], unaligned, fixed, image.astype(">u2"), np.asfortranarray(image)):
        assert rvl.encode(other) == expected
    for data in (bytearray(expected), memoryview(b"abc" + expected)[3:]):
        assert np.array_equal(rvl.decode(data, image.shape), image)


def test_writers_with_signed_pixels_decode_to_the_same_depth():
    # As int16, 40000 is -25536: the differences are -25536 and +25537, in zigzag 51071 and 51074.
    assert rvl.decode(words(0, 2, 51071, 51074), (1, 2)).tolist() == [[40000, 1]]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        words(6, 0)[:3],
        words(0, 6, 16, 16, 16),
        words(7, 0),
        words(2, 5, 2, 2, 2, 2, 2),
        words(2**29, 0),
        bytes.fromhex("ffffffff") * 2,
        words(0, 6, 8) + bytes.fromhex("ffffffff") * 2,
        words(0, 6, 2, 1, 2, 2, 2, 2),
        words(6, 0) + bytes(4),
    ],
)
def test_words_that_do_not_make_the_image_are_refused(data):
    with pytest.raises(BitstreamError, match="no words of one image of 3 x 2 pixels") as caught:
        rvl.decode(data, (2, 3))
    assert caught.value.size_bytes == len(data)


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (-1, 5), (2**32 - 1, 2**32 - 1), (8192, 8193)])
def test_sizes_beyond_the_limit_are_refused_before_memory_is_taken(shape):
    with pytest.raises(BitstreamError, match=str(MAX_PIXELS)):
        rvl.decode(words(6, 0), shape)


def test_an_empty_image_is_one_word_up_to_the_largest():
    assert rvl.encode(np.zeros((360, 640), np.uint16)) == words(640 * 360, 0)
    assert rvl.decode(words(MAX_PIXELS, 0), (8192, 8192)).shape == (8192, 8192)


def test_without_any_writable_cache_it_warns_and_still_encodes():
    code = (
        "import numba.core.caching as caching; caching.CacheImpl._locator_classes = []\n"
        "import numpy as np; from sfglab.codecs import rvl\n"
        "print(rvl.encode(np.zeros((2, 3), np.uint16)).hex())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "00000060"
    assert "NUMBA_CACHE_DIR" in done.stderr
