"""The first picture at once: decoder and keeper with real DDS, H.264 and processes."""

import asyncio
import os
import signal
from types import SimpleNamespace

import numpy as np
import pytest
from cameras import FFMPEG, IMAGE, LOCAL, STREAM, Camera
from waiting import until

from sfglab.codecs import H264Decoder
from sfglab.component import beside
from sfglab.fleet.gop_cache import REPLAY_QOS, KeeperSettings, StreamKeeper, replay_topic
from sfglab.messages import ns_from_stamp
from sfglab.qos import COMPRESSED_STREAM, SENSOR_DATA

pytestmark = [pytest.mark.live]

REPLAY = replay_topic(STREAM)
ENDLESS = 200
"""A group of pictures that outlasts the test: without a replay a late splicer would see nothing."""


class NoisyCamera(Camera):
    """Pictures that no two decoders would guess alike, in one group without end."""

    def __init__(self, node) -> None:
        super().__init__(node)
        self.gop = ENDLESS

    def picture(self, height: int, width: int) -> np.ndarray:
        rng = np.random.default_rng(self.level)
        return rng.integers(0, 255, (height // 16, width // 16, 3), np.uint8).repeat(16, 0).repeat(16, 1)


def kept(node):
    """A keeper beside the camera."""
    return beside(StreamKeeper(node, KeeperSettings(streams=(STREAM,))).run())


def number(image) -> int:
    return ns_from_stamp(image.header.stamp) // 10**9


async def test_a_splicer_in_mid_group_sees_pictures_equal_to_continuous_decoding_and_the_replay_is_left(serve):
    async with serve() as (far, near, decoder), kept(far):
        camera = NoisyCamera(far)
        await camera.publisher.wait_for_subscriptions(1, 15)
        sent = []
        tap = far.create_subscription(FFMPEG, STREAM, sent.append, qos=COMPRESSED_STREAM)
        await tap.wait_for_publishers(1, 15)
        async with camera.running():
            await camera.shot(25)
            began = camera.level
            subscription = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
            images = [await subscription.take(timeout_s=60) for _ in range(10)]
            await until(lambda: not far.graph.subscriptions(REPLAY) and decoder.status[LOCAL].statistics)
            said = decoder.status[LOCAL].statistics
        assert number(images[0]) >= began, "the past is decoded and not shown"
        assert said.replayed > 0
        assert said.broken == 0
        numbers = [number(image) for image in images]
        assert numbers == list(range(numbers[0], numbers[0] + 10)), "no gap, no repetition"
        continuous, expected = H264Decoder(), {}
        for packet in sent:
            (expected[number(packet)],) = continuous.decode_bgr(bytes(packet.data))
        for image in images:
            pixels = np.asarray(image.data).reshape(image.height, image.width, 3)
            assert np.array_equal(pixels, expected[number(image)])


async def test_a_pipeline_that_follows_another_shows_nothing_of_a_replay_from_before_what_was_seen(serve):
    """Routers keep a replay on for two seconds, or until the lease of a reader that was killed runs out."""
    async with serve() as (far, near, decoder):
        camera, shown, packets = NoisyCamera(far), [], []
        live, camera.publisher = camera.publisher, SimpleNamespace(publish=packets.append)
        camera.gop = 20
        async with camera.running():
            await camera.shot(60)
        past, coming = packets[:3], iter(packets[3:])
        take = {"callback": lambda image: shown.append(number(image)), "qos": SENSOR_DATA, "transport": "shm"}
        subscription = near.create_subscription(IMAGE, LOCAL, **take)

        async def join():
            """Send a replay of the past, of which a while later the rest comes, and then the stream."""
            await until(subscription.get_publisher_count)
            replay, seen = far.create_publisher(FFMPEG, REPLAY, REPLAY_QOS), len(shown)
            for packet in past[:3]:
                replay.publish(packet)
            await until(lambda: (s := decoder.status[LOCAL].statistics) and s.replayed >= 3)
            for packet in past[3:]:
                replay.publish(packet)
            while len(shown) < seen + 5:
                past.append(next(coming))
                replay.publish(past[-1])
                live.publish(past[-1])
                await asyncio.sleep(0.02)
            replay.close()

        await join()
        for pid in decoder.pool.pids:
            os.kill(pid, signal.SIGKILL)
        await until(lambda: "BACKING_OFF" in decoder.states[LOCAL])
        await decoder.reaches("RUNNING")
        await join()
        assert shown == sorted(set(shown))


@pytest.mark.parametrize(("changes", "idle"), [({"spare": False}, 0), ({"refill": False}, 1)])
async def test_the_papers_mode_does_not_replay_and_its_process_is_new_or_the_same(
    serve, monkeypatch, changes, idle
):
    monkeypatch.setattr("sfglab.fleet.decoder.process.REFILL_DELAY_S", 0)
    async with serve(replay=False, **changes) as (far, near, decoder):
        before = decoder.pool.pids
        assert len(before) == idle
        camera = Camera(far)
        async with kept(far), camera.running():
            subscription = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="dds")
            await subscription.take(timeout_s=60)
            assert not far.graph.subscriptions(REPLAY)
            assert len(decoder.pool.pids) == 1
            subscription.close()
            await until(lambda: decoder.status[LOCAL].state == "IDLE" and decoder.pool.pids == before)
            assert decoder.pool.warm
