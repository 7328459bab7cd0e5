"""What a keeper holds: always a group of pictures that a decoder can begin with, or nothing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.fleet.gop_cache import GopCache, KeeperSettings, Limits, replay_topic

COLOR = "/global/go2/camera_front/color/ffmpeg"


def fill(cache: GopCache[int], numbers, gop: int = 5, size_bytes: int = 10) -> list[bool]:
    return [cache.add(n, pts=n, is_key=n % gop == 0, size_bytes=size_bytes) for n in numbers]


@pytest.mark.parametrize(
    ("numbers", "packets", "dropped", "gaps"),
    [
        pytest.param([*range(8)], (5, 6, 7), [], 0, id="those since the last key frame"),
        pytest.param([3, 4], (), [3, 4], 0, id="none before the first key frame"),
        pytest.param([0, 1, 3, 4], (), [3, 4], 1, id="a gap makes the rest of a group useless"),
        pytest.param([0, 1, 3, 4, 5, 6], (5, 6), [3, 4], 1, id="until the next key frame"),
        pytest.param([10, 11, 12, 0, 1], (0, 1), [], 0, id="a sender that starts anew is followed"),
    ],
)
def test_what_is_kept(numbers, packets, dropped, gaps):
    cache: GopCache[int] = GopCache()
    kept = fill(cache, numbers)
    assert [number for number, one in zip(numbers, kept, strict=True) if not one] == dropped
    assert (cache.packets, len(cache), cache.size_bytes) == (packets, len(packets), 10 * len(packets))
    assert cache.gaps == gaps


@pytest.mark.parametrize(
    "limits", [Limits(packets=3), Limits(size_bytes=30)], ids=["too many packets", "too many bytes"]
)
def test_a_group_that_outgrows_the_limits_is_given_up_until_the_next_key_frame(limits):
    cache: GopCache[int] = GopCache(limits)
    assert fill(cache, range(5)) == [True, True, True, False, False]
    assert (cache.packets, cache.overflows, cache.size_bytes) == ((), 1, 0)
    fill(cache, [5])
    assert cache.packets == (5,)


@given(numbers=st.lists(st.integers(0, 40), max_size=60), gop=st.integers(1, 12), packets=st.integers(1, 8))
def test_the_cache_always_begins_with_a_key_frame_has_no_gap_and_respects_its_limits(numbers, gop, packets):
    cache: GopCache[int] = GopCache(Limits(packets=packets, size_bytes=1000))
    for number in numbers:
        kept = cache.add(number, pts=number, is_key=number % gop == 0, size_bytes=90)
        held = cache.packets
        assert kept == (held[-1:] == (number,) and len(held) > 0) or not kept
        assert held == tuple(range(held[0], held[0] + len(held))) if held else True
        assert not held or held[0] % gop == 0
        assert len(held) <= packets
        assert cache.size_bytes == 90 * len(held) <= 1000


@pytest.mark.parametrize("limits", [{"packets": 0}, {"size_bytes": 0}])
def test_limits_within_which_nothing_fits_are_refused(limits):
    with pytest.raises(InvalidValueError, match="1 or more"):
        Limits(**limits)


def test_a_streams_replay_is_named_by_the_schema():
    assert replay_topic(COLOR) == "/global/go2/camera_front/color/ffmpeg_replay"
    assert replay_topic(f"{COLOR}_hq") == "/global/go2/camera_front/color/ffmpeg_replay_hq"
    assert replay_topic("/local/go2/camera_front/color/ffmpeg") == "/local/go2/camera_front/color/ffmpeg_replay"


@pytest.mark.parametrize(
    "topic", ["/global/go2/camera_front/depth/compressed_depth", "/tf", "nonsense", replay_topic(COLOR)]
)
def test_what_is_no_numbered_stream_has_no_replay(topic):
    assert replay_topic(topic) is None
    with pytest.raises(InvalidValueError, match="ffmpeg"):
        KeeperSettings(streams=(topic,))


def test_more_than_a_replays_history_cannot_be_kept():
    with pytest.raises(InvalidValueError, match="1 to 256"):
        KeeperSettings(limits=Limits(packets=257))
