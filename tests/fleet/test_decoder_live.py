"""The decoder with real DDS, shared memory, H.264 and processes: on demand, once, released; first pictures."""

import asyncio
from dataclasses import replace

import numpy as np
import psutil
import pytest
from cameras import FFMPEG, IMAGE, LOCAL, STREAM, Camera
from waiting import until

from sfglab.codecs import H264Decoder
from sfglab.component import beside
from sfglab.errors import SfglabError
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.decoder.node import run_decoder
from sfglab.fleet.gop_cache import GopCacheNode
from sfglab.fleet.gop_config import replay_topic
from sfglab.messages import default_message, ns_from_stamp
from sfglab.qos import COMPRESSED_STREAM, SENSOR_DATA

pytestmark = [pytest.mark.live]


def number(image) -> int:
    """Return which picture it is, by its stamp."""
    return ns_from_stamp(image.header.stamp) // 10**9


def is_right(image) -> bool:
    """Return whether the decoded pixels are what the camera drew."""
    return abs(float(np.median(image.data)) - number(image)) <= 3


async def right_pictures(subscription, count: int = 5) -> list:
    images = [await subscription.take(timeout_s=60) for _ in range(count)]
    assert all(map(is_right, images))
    return images


def children() -> set[int]:
    return {p.pid for p in psutil.Process().children(recursive=True)}


async def test_one_pipeline_runs_for_all_while_anybody_subscribes_over_shared_memory_or_dds(serve):
    before = children()
    async with serve() as (far, near, decoder):
        camera = Camera(far)
        async with camera.running():
            assert decoder.status[LOCAL].state == "IDLE"
            assert camera.publisher.get_subscription_count() == 0, "no demand, no network load"
            shared = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
            plain = near.create_subscription(IMAGE, LOCAL)  # RELIABLE, as is ROS 2's default
            await right_pictures(shared)
            image, *_ = await right_pictures(plain)
            assert (image.encoding, image.height, image.width, image.step) == (
                "bgr8",
                192,
                320,
                960,
            )
            assert camera.publisher.get_subscription_count() == 1
            assert decoder.status[LOCAL].subscribers == 2
            shared.close()
            await right_pictures(plain)
            plain.close()
            await decoder.reaches("IDLE")
            await until(lambda: not camera.publisher.get_subscription_count())
        life = ["IDLE", "STARTING", "RUNNING", "LINGERING", "STOPPING", "IDLE"]
        assert decoder.states[LOCAL] == life
    assert children() == before, "the decoder leaves no process behind"


async def test_broken_packets_are_counted_and_heal_in_the_same_pipeline(serve):
    async with serve() as (far, near, decoder):
        camera = Camera(far)
        subscription = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
        async with camera.running():
            await right_pictures(subscription)
            data = np.frombuffer(b"\0\0\0\1\x65" + bytes(range(200)), dtype=np.uint8)
            size = {"width": camera.width, "height": camera.height}
            noise = {"encoding": "h264;yuv420p;bgr8;bgr8", "flags": 1, "data": data}
            for _ in range(5):
                camera.publisher.publish(default_message(FFMPEG, **size, **noise))
            async with asyncio.timeout(60):
                while not (s := decoder.status[LOCAL].statistics) or s.broken == 0:
                    await subscription.take()
            assert s.last_error
            images = [await subscription.take(timeout_s=60) for _ in range(15)]
            assert is_right(images[-1])
        assert decoder.states[LOCAL] == ["IDLE", "STARTING", "RUNNING"]


# --- The first picture at once, from what a keeper replays.

REPLAY = replay_topic(STREAM)
ENDLESS = 200
"""A group of pictures that outlasts the test: without a replay a late splicer would see nothing."""


class NoisyCamera(Camera):
    """Pictures that no two decoders would guess alike, in one group without end."""

    def __init__(self, node) -> None:
        super().__init__(node)
        self.gop = ENDLESS

    def picture(self) -> np.ndarray:
        rng = np.random.default_rng(self.level)
        coarse = rng.integers(0, 255, (self.height // 16, self.width // 16, 3), np.uint8)
        return coarse.repeat(16, 0).repeat(16, 1)


def kept(node):
    """A keeper beside the camera."""
    return beside(GopCacheNode(node, (STREAM,)).run())


async def test_a_splicer_in_mid_group_sees_pictures_equal_to_continuous_decoding_and_the_replay_is_left(
    serve,
):
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
            await until(
                lambda: not far.graph.subscriptions(REPLAY) and decoder.status[LOCAL].statistics
            )
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
            await until(
                lambda: decoder.status[LOCAL].state == "IDLE" and decoder.pool.pids == before
            )
            assert decoder.pool.warm


@pytest.mark.parametrize("side", ["local", "remote"])
def test_an_interface_that_does_not_exist_is_one_clear_error_and_leaves_no_process(
    domains, side, capfd
):
    sides = dict(zip(("remote", "local"), domains, strict=True))
    sides[side] = replace(sides[side], interface="nowhere0")
    before = children()
    with pytest.raises(SfglabError) as error:
        asyncio.run(run_decoder(DecoderConfig(**sides, streams=(STREAM,))))
    assert "no network interface 'nowhere0'" in str(error.value)
    assert "\n" not in str(error.value)
    assert "Traceback" not in capfd.readouterr().err
    assert children() == before
