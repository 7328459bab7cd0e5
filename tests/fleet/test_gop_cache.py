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


def fill(cache: gop_cache.GopCache[int], numbers, gop: int = 5, size_bytes: int = 10) -> list[bool]:
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
    cache: gop_cache.GopCache[int] = gop_cache.GopCache()
    kept = fill(cache, numbers)
    assert [number for number, one in zip(numbers, kept, strict=True) if not one] == dropped
    assert (cache.packets, len(cache), cache.size_bytes) == (
        packets,
        len(packets),
        10 * len(packets),
    )
    assert cache.gaps == gaps


@pytest.mark.parametrize("clock", CLOCKS)
def test_the_group_of_a_stream_without_numbers_is_kept(clock):
    cache: gop_cache.GopCache[int] = gop_cache.GopCache()
    for number in range(13):
        pts = CLOCKS[clock](number)
        assert cache.add(number, pts=pts, is_key=number % 5 == 0, size_bytes=10)
    assert (cache.packets, cache.gaps) == ((10, 11, 12), 0)


@pytest.mark.parametrize(
    "limits",
    [gop_config.Limits(packets=3), gop_config.Limits(size_bytes=30)],
    ids=["too many packets", "too many bytes"],
)
def test_a_group_that_outgrows_the_limits_is_given_up_until_the_next_key_frame(limits):
    cache: gop_cache.GopCache[int] = gop_cache.GopCache(limits)
    assert fill(cache, range(5)) == [True, True, True, False, False]
    assert (cache.packets, cache.overflows, cache.size_bytes) == ((), 1, 0)
    fill(cache, [5])
    assert cache.packets == (5,)


@given(
    numbers=st.lists(st.integers(0, 40), max_size=60),
    gop=st.integers(1, 12),
    packets=st.integers(1, 8),
)
def test_the_cache_always_begins_with_a_key_frame_has_no_gap_and_respects_its_limits(
    numbers, gop, packets
):
    cache: gop_cache.GopCache[int] = gop_cache.GopCache(
        gop_config.Limits(packets=packets, size_bytes=1000)
    )
    for number in numbers:
        kept = cache.add(number, pts=number, is_key=number % gop == 0, size_bytes=90)
        held = cache.packets
        assert kept == (held[-1:] == (number,) and len(held) > 0) or not kept
        assert held == tuple(range(held[0], held[0] + len(held))) if held else True
        assert not held or held[0] % gop == 0
        assert len(held) <= packets
        assert cache.size_bytes == 90 * len(held) <= 1000


@pytest.mark.parametrize(
    ("limits", "allowed"),
    [
        ({"packets": 0}, "1 or more"),
        ({"size_bytes": 0}, "1 or more"),
        ({"packets": 257}, "1 to 256"),
    ],
)
def test_limits_within_which_nothing_fits_or_beyond_a_replays_history_are_refused(limits, allowed):
    with pytest.raises(InvalidValueError, match=allowed):
        gop_config.GopCacheSettings(limits=gop_config.Limits(**limits))


def test_a_streams_replay_is_named_by_the_schema():
    for topic in (STREAM, STREAM.replace("global", "local")):
        assert gop_config.replay_topic(topic) == f"{topic}_replay"
    assert REPLAY == "/global/go2/camera_front/color/ffmpeg_replay"
    assert gop_config.replay_topic(f"{STREAM}_hq") == f"{REPLAY}_hq"


@pytest.mark.parametrize(
    "topic",
    ["/global/go2/camera_front/depth/compressed_depth", "/tf", "nonsense", REPLAY],
)
def test_what_is_no_numbered_stream_has_no_replay(topic):
    assert gop_config.replay_topic(topic) is None
    with pytest.raises(InvalidValueError, match="ffmpeg"):
        gop_config.GopCacheSettings(streams=(topic,))


async def read(near: Node, count: int) -> list:
    subscription = near.create_subscription(FFMPEG, REPLAY, qos=gop_config.REPLAY_QOS)
    packets = [await subscription.take(timeout_s=60) for _ in range(count)]
    subscription.close()
    return packets


@pytest.mark.parametrize("read_s", [0.2, 2.0], ids=["leaves before the replay", "stays"])
def test_a_replay_waits_until_connections_settle_and_is_not_sent_to_a_reader_that_left(read_s):
    settings = gop_config.GopCacheSettings(streams=(STREAM,), settle_s=0.5)
    replayed, times = [], []

    async def main(world):
        cache = gop_cache.GopCacheNode(world.node("cache"), settings, on_replay=replayed.append)
        reader = world.node("reader")
        async with beside(cache.run()):
            for _ in range(2):
                await asyncio.sleep(1)
                times.append(asyncio.get_running_loop().time())
                subscription = reader.create_subscription(FFMPEG, REPLAY, qos=gop_config.REPLAY_QOS)
                await asyncio.sleep(0.4)
                assert len(replayed) == len(times) - 1 if read_s > 1 else not replayed
                await asyncio.sleep(read_s - 0.4 if read_s > 1 else 0)
                subscription.close()

    run_simulated(main, seed=1, limit_s=60)
    assert len(replayed) == (2 if read_s > 1 else 0)


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
        async with beside(keeper.run()), camera.running():
            await camera.publisher.wait_for_subscriptions(1, 15)
            await camera.shot(30)
            assert replayed == [], "nothing is written while nobody reads"
            packets = await read(near, 60)
            (report,) = replayed
            numbers = [p.pts for p in packets]
            assert packets[0].flags & gop_config.FLAG_KEY
            assert numbers == list(range(numbers[0], numbers[0] + 60)), "no gap, no repetition"
            assert report.packets <= camera.gop
            burst, rest = packets[: report.packets], packets[report.packets :]
            assert all(p.flags & gop_config.FLAG_DISCARD for p in burst[:-1])
            assert not any(p.flags & gop_config.FLAG_DISCARD for p in [*burst[-1:], *rest])
            assert report.size_bytes == sum(len(p.data) for p in burst)
            assert (report.gaps, report.overflows) == (0, 0)
            await camera.shot(2 * camera.gop)
            second = await read(near, 3)
            assert second[0].flags & gop_config.FLAG_KEY
            assert second[0].pts > numbers[-1]
            assert len(replayed) == 2
            await camera.shot(2 * camera.gop)
            plain = near.create_subscription(FFMPEG, REPLAY, qos=SENSOR_DATA)
            assert (await plain.take(timeout_s=60)).encoding.startswith("h264")
            assert len(replayed) == 3, "who asks for best effort is served too"
