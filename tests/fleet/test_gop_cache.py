"""GOP cache: it keeps a decodable group, and writes nothing without a reader."""

import asyncio
import itertools

import pytest
from cameras import FFMPEG, STREAM
from foreign_video import CLOCKS
from hypothesis import given
from hypothesis import strategies as st

from sfglab.bus.address import BusAddress
from sfglab.bus.sim import run_simulated
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet import gop_cache, gop_config
from sfglab.messages import default_message
from sfglab.qos import COMPRESSED_STREAM, SENSOR_DATA

REPLAY = gop_config.replay_topic(STREAM)


@pytest.mark.parametrize("clock", CLOCKS.values(), ids=CLOCKS)
def test_the_group_of_a_stream_without_numbers_is_kept(clock):
    cache = gop_cache.GopCache()
    for n in range(13):
        assert cache.add(n, pts=clock(n), is_key=n % 5 == 0, size_bytes=10)
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
    group = []
    for number in (0, 1, *numbers):  # so it is a stream with numbers
        follows = bool(group) and number == group[-1] + 1 and len(group) < packets
        group = [number] if number % gop == 0 else [*group, number] if follows else []
        kept = cache.add(number, pts=number, is_key=number % gop == 0, size_bytes=90)
        assert (cache.packets, kept) == (tuple(group), bool(group))
        assert cache.size_bytes == 90 * len(group)


@pytest.mark.parametrize(
    "topic",
    ["/global/go2/camera_front/depth/compressed_depth", "/tf", "nonsense", REPLAY],
)
def test_what_is_no_numbered_stream_has_no_replay(topic):
    assert gop_config.replay_topic(topic) is None
    with pytest.raises(InvalidValueError, match="ffmpeg"):
        gop_config.GopCacheConfig(address=BusAddress(domain_id=1), streams=(topic,))


def served(read):
    """Run a GOP cache beside a camera that numbers its packets, 20 a group; return the replays."""
    replayed = []

    async def shoot(node):
        publisher = node.create_publisher(FFMPEG, STREAM, COMPRESSED_STREAM)
        for number in itertools.count():
            flags = gop_config.FLAG_KEY if number % 20 == 0 else 0
            publisher.publish(default_message(FFMPEG, pts=number, flags=flags))
            await asyncio.sleep(0.02)

    async def main(world):
        cache = gop_cache.GopCacheNode(world.node("cache"), (STREAM,), on_replay=replayed.append)
        async with beside(cache.run(), shoot(world.node("camera"))):
            await asyncio.sleep(1)
            assert not replayed, "nothing is written while nobody reads"
            await read(world.node("reader"))
            await asyncio.sleep(1)

    run_simulated(main, seed=1, limit_s=60)
    return replayed


@pytest.mark.parametrize("stays_s", [0.4, 2.0], ids=["leaves before the replay", "stays"])
def test_a_replay_waits_until_connections_settle_and_is_not_sent_to_a_reader_that_left(
    monkeypatch, stays_s
):
    monkeypatch.setattr(gop_cache, "SETTLE_S", 0.5)

    async def read(node):
        subscription = node.create_subscription(FFMPEG, REPLAY, qos=gop_config.REPLAY_QOS)
        await asyncio.sleep(stays_s)
        subscription.close()

    assert len(served(read)) == (stays_s > 1)


def test_each_late_reader_gets_the_group_under_way_and_what_follows_and_nothing_from_before():
    read = []

    async def take(node):
        reliable = gop_config.REPLAY_QOS
        for count, qos in ((60, reliable), (3, reliable), (1, SENSOR_DATA)):
            subscription = node.create_subscription(FFMPEG, REPLAY, qos=qos)
            read.append([await subscription.take(timeout_s=60) for _ in range(count)])
            subscription.close()
            await asyncio.sleep(1)

    replayed = served(take)
    assert len(replayed) == 3, "who asks for best effort is served too"
    packets, (second, *_), _ = read
    first = packets[0].pts
    assert packets[0].flags & second.flags & gop_config.FLAG_KEY
    assert [packet.pts for packet in packets] == [*range(first, first + 60)]
    assert replayed[0].packets <= 20
    discarded = [bool(packet.flags & gop_config.FLAG_DISCARD) for packet in packets]
    assert discarded == [number < replayed[0].packets - 1 for number in range(60)]
    assert second.pts > packets[-1].pts
