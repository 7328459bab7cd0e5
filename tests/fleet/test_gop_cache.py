"""GOP cache: it keeps a decodable group, and writes nothing without a reader."""

import asyncio

import pytest
from cameras import FFMPEG, STREAM, Camera
from foreign_video import CLOCKS
from hypothesis import given
from hypothesis import strategies as st

from sfglab.bus import Node
from sfglab.bus.sim import run_simulated
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet import gop_cache, gop_config
from sfglab.qos import SENSOR_DATA

REPLAY = gop_config.replay_topic(STREAM)


def fill(cache: gop_cache.GopCache, numbers, gop: int = 5, size_bytes: int = 10) -> list[bool]:
    return [cache.add(n, pts=n, is_key=n % gop == 0, size_bytes=size_bytes) for n in numbers]


@pytest.mark.parametrize(
    ("numbers", "packets", "dropped"),
    [
        pytest.param([*range(8)], (5, 6, 7), [], id="those since the last key frame"),
        pytest.param([3, 4], (), [3, 4], id="none before the first key frame"),
        pytest.param([0, 1, 3, 4, 5, 6], (5, 6), [3, 4], id="a gap makes a group useless"),
        pytest.param([10, 11, 12, 0, 1], (0, 1), [], id="a sender that starts anew is followed"),
    ],
)
def test_what_is_kept(numbers, packets, dropped):
    cache = gop_cache.GopCache()
    kept = fill(cache, numbers)
    assert [number for number, one in zip(numbers, kept, strict=True) if not one] == dropped
    assert cache.packets == packets


@pytest.mark.parametrize("clock", CLOCKS)
def test_the_group_of_a_stream_without_numbers_is_kept(clock):
    cache = gop_cache.GopCache()
    for number in range(13):
        pts = CLOCKS[clock](number)
        assert cache.add(number, pts=pts, is_key=number % 5 == 0, size_bytes=10)
    assert cache.packets == (10, 11, 12)


@given(
    numbers=st.lists(st.integers(0, 40), max_size=60),
    gop=st.integers(1, 12),
    packets=st.integers(1, 8),
)
def test_the_cache_always_begins_with_a_key_frame_has_no_gap_and_respects_its_limits(
    numbers, gop, packets
):
    cache = gop_cache.GopCache(packets, max_bytes=1000)
    for number in (0, 1, *numbers):  # so it is a stream with numbers
        fill(cache, [number], gop, size_bytes=90)
        held = cache.packets
        if held:
            assert held == tuple(range(held[0], held[-1] + 1))
            assert held[0] % gop == 0
        assert len(held) <= packets
        assert number % gop or held == (number,), "every key frame begins a group"
        assert cache.size_bytes == 90 * len(held) <= 1000


@pytest.mark.parametrize(
    "topic",
    ["/global/go2/camera_front/depth/compressed_depth", "/tf", "nonsense", REPLAY],
)
def test_what_is_no_numbered_stream_has_no_replay(topic):
    assert gop_config.replay_topic(topic) is None
    with pytest.raises(InvalidValueError, match="ffmpeg"):
        gop_config.GopCacheSettings(streams=(topic,))


@pytest.mark.parametrize("stays_s", [0.4, 2.0], ids=["leaves before the replay", "stays"])
def test_a_replay_waits_until_connections_settle_and_is_not_sent_to_a_reader_that_left(stays_s):
    settings = gop_config.GopCacheSettings(streams=(STREAM,), settle_s=0.5)
    replayed = []

    async def main(world):
        cache = gop_cache.GopCacheNode(world.node("cache"), settings, on_replay=replayed.append)
        reader = world.node("reader")
        async with beside(cache.run()):
            await asyncio.sleep(1)
            subscription = reader.create_subscription(FFMPEG, REPLAY, qos=gop_config.REPLAY_QOS)
            await asyncio.sleep(0.4)
            assert not replayed
            await asyncio.sleep(stays_s - 0.4)
            subscription.close()
            await asyncio.sleep(1)

    run_simulated(main, seed=1, limit_s=60)
    assert len(replayed) == (stays_s > 1)


@pytest.mark.live
async def test_each_late_reader_gets_the_group_under_way_and_what_follows_and_nothing_from_before(
    domains,
):
    address, replayed = domains[0].options(), []
    async with (
        Node("camera", **address) as far,
        Node("keeper", **address) as here,
        Node("reader", **address) as near,
    ):
        told = gop_config.GopCacheSettings(streams=(STREAM,))
        keeper = gop_cache.GopCacheNode(here, told, on_replay=replayed.append)
        camera = Camera(far)
        camera.gop = 20

        async def read(count, qos):
            await camera.shot(2 * camera.gop)
            subscription = near.create_subscription(FFMPEG, REPLAY, qos=qos)
            packets = [await subscription.take(timeout_s=60) for _ in range(count)]
            subscription.close()
            return packets

        async with beside(keeper.run()), camera.running():
            await camera.publisher.wait_for_subscriptions(1, 15)
            await camera.shot(1)
            assert replayed == [], "nothing is written while nobody reads"
            packets = await read(60, gop_config.REPLAY_QOS)
            (report,) = replayed
            first = packets[0].pts
            assert packets[0].flags & gop_config.FLAG_KEY
            assert [p.pts for p in packets] == [*range(first, first + 60)]
            assert report.packets <= camera.gop
            discarded = [bool(p.flags & gop_config.FLAG_DISCARD) for p in packets]
            assert discarded == [n < report.packets - 1 for n in range(60)]
            second, *_ = await read(3, gop_config.REPLAY_QOS)
            assert second.flags & gop_config.FLAG_KEY
            assert second.pts > packets[-1].pts
            await read(1, SENSOR_DATA)
            assert len(replayed) == 3, "who asks for best effort is served too"
