"""Standard values, suffixes and Custom: every text has one reading."""

import pickle
import re
from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.names import After, Component, Custom, FqnError, Resource, ResourceKind, Stream
from sfglab.names.vocabulary import read_standard

SETS = (Component, Stream, Resource)
TAKEN = {(Resource.COMPRESSED, "depth"), (Resource.FFMPEG, "replay")}
"""Values and first words of suffixes that together spell another standard value."""
STANDARD = st.sampled_from([value for values in SETS for value in values])
SUFFIXES = st.from_regex(r"[A-Za-z0-9]{1,5}(_[A-Za-z0-9]{1,4}){0,2}", fullmatch=True)


@pytest.mark.parametrize("values", SETS)
def test_standard_values_are_lower_case_words_that_end_in_a_letter_and_differ(values):
    texts = [value.text for value in values]
    assert len(set(texts)) == len(list(values.__members__)) == len(texts)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)*", text) for text in texts)
    assert all(values(text).name == text.upper() for text in texts)


def test_only_compressed_depth_and_ffmpeg_replay_continue_another_and_all_stand_somewhere():
    continued = {
        (longer.text, shorter.text)
        for values in SETS
        for longer, shorter in permutations(values, 2)
        if re.fullmatch(rf"{shorter.text}(_.*|[0-9]+)", longer.text)
    }
    assert continued == {("compressed_depth", "compressed"), ("ffmpeg_replay", "ffmpeg")}
    assert all(resource.after for resource in Resource)
    assert {resource.kind for resource in Resource} == set(ResourceKind)


@pytest.mark.parametrize(
    ("value", "suffix", "text"),
    [
        (Component.CAMERA, "front", "camera_front"),
        (Stream.INFRA, "1", "infra1"),
        (Stream.INFRA, "2_rect", "infra_2_rect"),
        (Component.ARM, "left_2", "arm_left_2"),
        (Resource.COMPRESSED, "x", "compressed_x"),
    ],
)
def test_digits_follow_directly_and_other_suffixes_behind_an_underscore(value, suffix, text):
    assert value.suffixed(suffix).text == text


@given(value=STANDARD, suffix=SUFFIXES)
def test_a_suffix_that_is_accepted_reads_back_equal(value, suffix):
    if (value, suffix.split("_")[0]) in TAKEN:
        return  # the only refusals; they have their own test
    segment = value.suffixed(suffix)
    assert read_standard(type(value), segment.text) == segment


@given(a=STANDARD, b=STANDARD, first=SUFFIXES, second=SUFFIXES)
def test_no_two_suffixed_values_of_a_set_are_written_alike(a, b, first, second):
    try:
        one, two = a.suffixed(first), b.suffixed(second)
    except FqnError:
        return
    if type(a) is type(b) and one.text == two.text:
        assert one == two
    assert one.text not in {value.text for value in type(a)}


def test_a_suffix_that_spells_another_value_and_digits_behind_an_underscore_are_refused():
    for suffix in ("depth", "depth_left"):
        with pytest.raises(FqnError, match=r"Resource\.COMPRESSED_DEPTH"):
            Resource.COMPRESSED.suffixed(suffix)
    with pytest.raises(FqnError, match=r"Resource\.FFMPEG_REPLAY"):
        Resource.FFMPEG.suffixed("replay")
    assert read_standard(Resource, "compressed_depth_left") == Resource.COMPRESSED_DEPTH.suffixed(
        "left"
    )
    with pytest.raises(FqnError, match=r"^component: .*'camera1'"):
        read_standard(Component, "camera_1")


@pytest.mark.parametrize("text", ["cameras", "mast", "arm64x", "my_camera", "infra1_left"])
def test_what_only_resembles_a_standard_value_is_none(text):
    assert read_standard(Component, text) is None


@pytest.mark.parametrize(
    "text", ["", "_x", "x_", "a__b", "9a", "a b", "a/b", "ä", "a\n", "-", "\u0661"]
)
def test_suffixes_and_customs_take_only_words_of_a_ros_name(text):
    if text != "9a":  # which may stand behind a word
        with pytest.raises(FqnError, match=r"^suffix: .*component suffix"):
            Component.CAMERA.suffixed(text)
    with pytest.raises(FqnError, match="words") as caught:
        Custom(text)
    assert (caught.value.place, caught.value.given) == ("custom", text)


def test_custom_resources_may_follow_everything_and_are_topics_unless_said_otherwise():
    assert Custom("gait").after == After.SCOPE | After.AGENT | After.COMPONENT | After.STREAM
    assert Custom("gait").kind is ResourceKind.TOPIC
    assert Custom("gait", kind=ResourceKind.SERVICE) != Custom("gait")


@pytest.mark.parametrize(
    "value", [Resource.GET_METADATA, Stream.INFRA.suffixed("1"), Custom("gait")]
)
def test_segments_survive_pickling(value):
    assert pickle.loads(pickle.dumps(value)) == value  # noqa: S301 - our own bytes
