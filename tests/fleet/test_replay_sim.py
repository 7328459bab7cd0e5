"""The first picture over two routers in the simulated world: the same keeper, router and pipeline."""

import asyncio
from contextlib import asynccontextmanager
from dataclasses import replace

import numpy as np
import pytest
from cameras import behind_router, packet_message, rolled

from sfglab.bus.sim import run_simulated
from sfglab.codecs import TABLE_2, H264Decoder
from sfglab.component import beside
from sfglab.fleet.decoder.pipeline import REPLAY_TIMEOUT_S, Statistics, run_pipeline
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.fleet.gop_cache import GopCacheNode
from sfglab.fleet.gop_config import FFMPEG_PACKET
from sfglab.messages import default_message
from sfglab.qos import COMPRESSED_STREAM

STREAM = "/global/edge/camera_front/color/ffmpeg"
FRAMES, JOINED = 66, 34
FPS = TABLE_2.fps


@pytest.fixture(scope="module")
def packets():
    header = default_message("std_msgs/msg/Header")
    return [packet_message(fields, header) for fields in rolled(TABLE_2, FRAMES)]


@pytest.fixture(scope="module")
def pictures(packets):
    """The pictures as one decoder shows them that has seen all packets."""
    decoder = H264Decoder()
    return [decoder.decode_bgr(bytes(packet.data))[0] for packet in packets]


class Screen(list):
    """Where a pipeline's pictures go, with the time of the first one, seconds."""

    def open(self):
        pass

    def publish(self, _, picture):
        if not self:
            self.first_s = asyncio.get_running_loop().time()
        self.append(picture)


@asynccontextmanager
async def agent(world, name, *bodies):
    """An agent's domain behind its router, and what runs in it; yields a node there."""
    node, router = behind_router(world, name)
    async with beside(router.run(), *(body(node) for body in bodies)) as tasks:
        yield node
        assert not any(task.done() for task in tasks)


def first_picture(packets, latency_s, *, keeper, joined=JOINED, fps=FPS):
    """Return the time from joining, half a frame after the given one, to the first picture, in seconds."""
    screen, counts = Screen(), Statistics()
    route, _ = routes_of_topic(STREAM)

    async def shoot(node):
        publisher = node.create_publisher(FFMPEG_PACKET, STREAM, COMPRESSED_STREAM)
        await asyncio.sleep(5)
        for packet in packets:
            publisher.publish(packet)
            await asyncio.sleep(1 / fps)
        await asyncio.Event().wait()

    async def keep(node):
        await GopCacheNode(node, (STREAM,)).run()

    async def main(world):
        async with (
            agent(world, "edge", shoot, *([keep] if keeper else [])),
            agent(world, "station") as near,
        ):
            await asyncio.sleep(5 + (joined + 0.5) / fps)
            joined_s = asyncio.get_running_loop().time()
            async with beside(run_pipeline(route, remote=near, outputs=screen, counts=counts)):
                await asyncio.sleep(FRAMES / fps)
                assert near.graph.subscriptions(route.replay_topic) == (), "the replay is left"
            return joined_s

    joined_s = run_simulated(main, seed=1, latency_s=latency_s, limit_s=60)
    return screen.first_s - joined_s, counts, screen


def test_with_a_keeper_the_first_picture_is_there_at_once_and_without_one_at_the_next_key_frame(
    packets, pictures
):
    waited_s, _, _ = first_picture(packets, 0.001, keeper=False)
    assert waited_s == pytest.approx((60 - JOINED - 0.5) / FPS, abs=0.02)
    replayed_s, counts, screen = first_picture(packets, 0.001, keeper=True)
    assert replayed_s < 0.1
    assert counts.replayed > 0
    assert len(screen) >= FRAMES - JOINED - 4, "and every picture from then on"
    assert all(map(np.array_equal, screen, pictures[-len(screen) :]))


def test_a_broken_packet_is_counted_and_the_next_key_frame_heals(packets, pictures):
    damaged = packets.copy()
    damaged[40] = replace(packets[40], data=packets[40].data[:100])
    _, counts, screen = first_picture(damaged, 0.001, keeper=True)
    assert (counts.broken, bool(counts.last_error)) == (1, True)
    assert len(screen) < FRAMES - 60 + 40 - JOINED + 1
    assert all(map(np.array_equal, screen[-5:], pictures[-5:]))


def test_on_a_slow_link_the_group_still_comes_before_the_next_key_frame(packets):
    replayed_s, counts, _ = first_picture(packets, 0.05, keeper=True)
    assert (replayed_s < 0.5, counts.broken) == (True, 0)


def test_a_replay_that_never_comes_is_given_up_and_the_next_key_frame_awaited(packets):
    waited_s, counts, _ = first_picture(packets, 0.0, keeper=False, joined=2, fps=5)
    assert waited_s == pytest.approx((TABLE_2.gop - 2.5) / 5, abs=0.05)
    assert waited_s > REPLAY_TIMEOUT_S
    assert (counts.replayed, counts.broken) == (0, 0)
