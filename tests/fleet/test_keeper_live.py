"""The keeper on real DDS: silent until somebody reads, then exactly the group that is under way."""

from contextlib import asynccontextmanager

import pytest
from cameras import FFMPEG, STREAM, Camera
from waiting import DEADLINE_S, process, until

from sfglab.bus import Node
from sfglab.component import beside
from sfglab.fleet.gop_cache import (
    FLAG_DISCARD,
    FLAG_KEY,
    REPLAY_QOS,
    KeeperConfig,
    KeeperSettings,
    Limits,
    StreamKeeper,
    replay_topic,
)
from sfglab.qos import SENSOR_DATA

pytestmark = [pytest.mark.live]

REPLAY = replay_topic(STREAM)


@asynccontextmanager
async def keeping(domains, *, gop: int = 20, **settings):
    """A camera, a keeper and a node that reads, with everything that the keeper reported."""
    address = domains[0].options()
    replayed = []
    async with (
        Node("camera", **address) as far,
        Node("keeper", **address) as here,
        Node("reader", **address) as near,
    ):
        keeper = StreamKeeper(here, KeeperSettings(streams=(STREAM,), **settings), on_replay=replayed.append)
        camera = Camera(far)
        camera.gop = gop
        async with beside(keeper.run()):
            await camera.publisher.wait_for_subscriptions(1, 15)
            async with camera.running():
                yield near, camera, replayed


async def read(near: Node, count: int) -> list:
    subscription = near.create_subscription(FFMPEG, REPLAY, qos=REPLAY_QOS)
    packets = [await subscription.take(timeout_s=60) for _ in range(count)]
    subscription.close()
    return packets


async def test_a_late_reader_gets_the_group_under_way_and_then_what_follows(domains):
    async with keeping(domains) as (near, camera, replayed):
        await camera.shot(30)
        assert replayed == [], "nothing is written while nobody reads"
        packets = await read(near, 60)
        (report,) = replayed
        numbers = [p.pts for p in packets]
        assert packets[0].flags & FLAG_KEY
        assert numbers == list(range(numbers[0], numbers[0] + 60)), "no gap, no repetition"
        assert report.packets <= camera.gop
        burst, rest = packets[: report.packets], packets[report.packets :]
        assert all(p.flags & FLAG_DISCARD for p in burst[:-1])
        assert not any(p.flags & FLAG_DISCARD for p in [*burst[-1:], *rest])
        assert report.size_bytes == sum(len(p.data) for p in burst)
        assert (report.gaps, report.overflows) == (0, 0)


async def test_the_next_reader_hears_nothing_of_the_replay_before_its_own(domains):
    async with keeping(domains) as (near, camera, replayed):
        await camera.shot(10)
        first = await read(near, 3)
        await camera.shot(2 * camera.gop)
        second = await read(near, 3)
        assert second[0].flags & FLAG_KEY
        assert second[0].pts >= first[0].pts + camera.gop
        assert len(replayed) == 2


async def test_a_group_that_is_too_long_is_not_replayed_and_the_live_stream_is_not_touched(domains):
    async with keeping(domains, gop=10_000, limits=Limits(packets=5)) as (near, camera, replayed):
        live = near.create_subscription(FFMPEG, STREAM, qos=SENSOR_DATA)
        await camera.shot(20)
        subscription = near.create_subscription(FFMPEG, REPLAY, qos=REPLAY_QOS)
        await until(lambda: replayed)
        assert (replayed[0].packets, replayed[0].overflows) == (0, 1)
        await live.take(timeout_s=60)
        with pytest.raises(TimeoutError):
            await subscription.take(timeout_s=0.2)


async def test_a_best_effort_reader_is_served_too(domains):
    async with keeping(domains) as (near, camera, replayed):
        await camera.shot(5)
        plain = near.create_subscription(FFMPEG, REPLAY, qos=SENSOR_DATA)
        packet = await plain.take(timeout_s=60)
        assert replayed
        assert packet.encoding.startswith("h264")


async def test_the_process_reports_ready_and_ends_with_its_input(domains):
    config = KeeperConfig(address=domains[0], streams=(STREAM,), limits=Limits(packets=60), settle_s=0.02)
    async with process("sfglab.fleet.gop_cache", config) as child:
        await child.expect("ready", timeout_s=DEADLINE_S)
    assert child.status == 0
