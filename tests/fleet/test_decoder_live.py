"""The decoder with real DDS, shared memory, H.264 and processes: on demand, once, released."""

import asyncio
import itertools
from dataclasses import asdict, replace

import numpy as np
import psutil
import pytest
from cameras import FFMPEG, IMAGE, LOCAL, STREAM, packet_message
from waiting import DEADLINE_S, until

from sfglab.bus import Node
from sfglab.codecs import H264Encoder, H264Settings, ffmpeg_packet_fields
from sfglab.component import beside
from sfglab.errors import SfglabError
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.decoder.node import run_decoder
from sfglab.messages import message_type, stamp_from_ns
from sfglab.qos import SENSOR_DATA, QoSProfile, Reliability

pytestmark = [pytest.mark.live]


async def right_pictures(subscription):
    """Return pictures after a check that each has the level of the camera at its stamp."""
    images = [await subscription.take(timeout_s=60) for _ in range(5)]
    for image in images:
        level = image.header.stamp.sec
        assert abs(float(np.median(image.data)) - level) <= 3
    return images


def children():
    return {p.pid for p in psutil.Process().children(recursive=True)}


async def shoot(publisher):
    """Publish flat pictures, 50 a second, whose blue level is the stamp's number of seconds."""
    settings = H264Settings(
        width=320, height=192, fps=50, bitrate_bps=1_000_000, gop=5, encoder="libx264"
    )
    encoder = H264Encoder(settings)
    for level in itertools.cycle(range(1, 201)):
        stamp = stamp_from_ns(level * 10**9)
        header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="camera")
        for packet in encoder.encode(np.full((192, 320, 3), level, np.uint8)):
            publisher.publish(packet_message(ffmpeg_packet_fields(packet, settings), header))
        await asyncio.sleep(0.02)


async def test_one_pipeline_runs_for_all_while_anybody_subscribes_over_shared_memory_or_dds(
    domains,
):
    before = children()
    remote, local = domains
    seen, ready = [], asyncio.Event()
    config = DecoderConfig(remote=remote, local=local, streams=(STREAM,), idle_timeout_s=0.05)
    decoding = run_decoder(config, on_status=seen.append, on_ready=lambda _: ready.set())

    def images():
        return [status for status in seen if status.local_topic == LOCAL]

    async with (
        Node("camera", **asdict(remote)) as far,
        Node("viewer", **asdict(local)) as near,
        beside(decoding),
    ):
        await asyncio.wait_for(ready.wait(), DEADLINE_S)
        qos = QoSProfile(reliability=Reliability.BEST_EFFORT, depth=60)
        publisher = far.create_publisher(FFMPEG, STREAM, qos)
        async with beside(shoot(publisher)):
            await until(images)
            assert publisher.get_subscription_count() == 0, "no demand, no network load"
            shared = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
            plain = near.create_subscription(IMAGE, LOCAL)  # RELIABLE, as is ROS 2's default
            await right_pictures(shared)
            image, *_ = await right_pictures(plain)
            shape = (image.encoding, image.height, image.width, image.step)
            assert shape == ("bgr8", 192, 320, 960)
            assert publisher.get_subscription_count() == 1
            assert images()[-1].subscribers == 2
            shared.close()
            await right_pictures(plain)
            plain.close()
            await until(lambda: images()[-1].state == "IDLE")
            await until(lambda: not publisher.get_subscription_count())
        life = [state for state, _ in itertools.groupby(status.state for status in images())]
        assert life == ["IDLE", "STARTING", "RUNNING", "LINGERING", "STOPPING", "IDLE"]
    assert children() == before, "the decoder leaves no process behind"


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
