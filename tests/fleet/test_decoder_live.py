"""The decoder with real DDS, shared memory, H.264 and processes: on demand, once, recovered, released."""

import asyncio
import os
import signal
from dataclasses import replace

import numpy as np
import psutil
import pytest
from cameras import FFMPEG, IMAGE, INFO, LOCAL, LOCAL_INFO, STREAM, Camera
from test_decoder_streams import metadata
from waiting import process, until

from sfglab.errors import SfglabError
from sfglab.fleet.decoder.node import DecoderConfig, run_decoder
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS
from sfglab.messages import default_message, ns_from_stamp
from sfglab.qos import SENSOR_DATA

pytestmark = [pytest.mark.live]


def level_of(image) -> float:
    """What the camera drew, read from the decoded pixels."""
    return float(np.median(image.data))


async def right_pictures(subscription, count: int = 5) -> list:
    """Take pictures and check each against its stamp."""
    images = [await subscription.take(timeout_s=60) for _ in range(count)]
    for image in images:
        assert abs(level_of(image) - ns_from_stamp(image.header.stamp) / 1e9) <= 3
    return images


def children() -> set[int]:
    return {p.pid for p in psutil.Process().children(recursive=True)}


async def test_nothing_runs_until_somebody_subscribes_and_nothing_after_the_last_left(serve):
    before = children()
    async with serve() as (far, near, decoder):
        camera = Camera(far)
        async with camera.running():
            assert decoder.status[LOCAL].state == "IDLE"
            assert camera.publisher.get_subscription_count() == 0, "no demand, no network load"
            first = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
            second = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
            await right_pictures(first)
            await right_pictures(second)
            assert camera.publisher.get_subscription_count() == 1, "one pipeline for two subscribers"
            assert decoder.status[LOCAL].subscribers == 2
            first.close()
            await right_pictures(second)
            second.close()
            await decoder.reaches("IDLE")
            await until(lambda: not camera.publisher.get_subscription_count())
        assert decoder.states[LOCAL] == ["IDLE", "STARTING", "RUNNING", "LINGERING", "STOPPING", "IDLE"]
    assert children() == before, "the decoder leaves no process behind"


async def test_a_plain_dds_subscriber_is_served_from_the_same_pipeline_which_is_replaced_when_killed(serve):
    async with serve() as (far, near, decoder), Camera(far).running():
        shared = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
        await right_pictures(shared)
        plain = near.create_subscription(IMAGE, LOCAL)  # RELIABLE, as is ROS 2's default
        images = await right_pictures(plain)
        assert images[0].encoding == "bgr8"
        assert (images[0].height, images[0].width, images[0].step) == (192, 320, 960)
        await right_pictures(shared)
        await until(lambda: len(decoder.pool.pids) == 2)  # one pipeline and, a while later, one spare
        for pid in decoder.pool.pids:
            os.kill(pid, signal.SIGKILL)
        await until(lambda: "BACKING_OFF" in decoder.states[LOCAL])
        await decoder.reaches("RUNNING")
        await until(shared.get_publisher_count)
        await right_pictures(shared, 20)
        assert decoder.status[LOCAL].crashes >= 1


async def test_broken_packets_are_counted_and_heal_and_a_stream_that_changes_its_size_is_followed(serve):
    async with serve() as (far, near, decoder):
        camera = Camera(far)
        subscription = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
        async with camera.running():
            await right_pictures(subscription)
            for _ in range(5):
                noise = default_message(FFMPEG)
                noise.encoding = "h264;yuv420p;bgr8;bgr8"
                noise.flags = 1
                noise.width, noise.height = camera.size
                noise.data = np.frombuffer(b"\0\0\0\1\x65" + bytes(range(200)), dtype=np.uint8)
                camera.publisher.publish(noise)
            async with asyncio.timeout(60):
                while not (s := decoder.status[LOCAL].statistics) or s.broken == 0:
                    await subscription.take()
            assert s.last_error
            images = [await subscription.take(timeout_s=60) for _ in range(15)]
            assert abs(level_of(images[-1]) - ns_from_stamp(images[-1].header.stamp) / 1e9) <= 3
        camera.size = (640, 368)
        async with camera.running():
            async with asyncio.timeout(60):
                while (image := await subscription.take()).width != 640:
                    pass
            assert image.height == 368
            await right_pictures(subscription)
        assert decoder.states[LOCAL] == ["IDLE", "STARTING", "RUNNING"], "the same pipeline all along"


async def test_camera_info_is_relayed_unchanged_on_demand(serve):
    async with serve() as (far, near, decoder):
        publisher = far.create_publisher("sensor_msgs/msg/CameraInfo", INFO, SENSOR_DATA)
        subscription = near.create_subscription("sensor_msgs/msg/CameraInfo", LOCAL_INFO, qos=SENSOR_DATA)
        await publisher.wait_for_subscriptions(1, 15)
        info = default_message("sensor_msgs/msg/CameraInfo")
        info.width, info.height, info.distortion_model = 640, 360, "plumb_bob"
        info.d = np.array([0.1, 0.2])
        async with asyncio.timeout(60):
            while True:
                publisher.publish(info)
                try:
                    seen = await subscription.take(timeout_s=0.1)
                    break
                except TimeoutError:
                    continue
        assert (seen.width, seen.distortion_model, list(seen.d)) == (640, "plumb_bob", [0.1, 0.2])
        assert decoder.status[LOCAL].state == "IDLE", "nobody asked for the pictures"


def discovery_event(kind: str):
    event = default_message(DISCOVERY_EVENT)
    return replace(event, agent="go2", event=getattr(event, kind), metadata=metadata(STREAM, codec="h264"))


async def test_agents_come_and_go_by_discovery_events(serve):
    topic = "/local/station/agent_discovery_event"
    async with serve(streams=(), discovery_topic=topic) as (far, near, decoder), Camera(far).running():
        subscription = near.create_subscription(IMAGE, LOCAL, qos=SENSOR_DATA, transport="shm")
        discoverer = near.create_publisher(DISCOVERY_EVENT, topic, DISCOVERY_QOS)
        await discoverer.wait_for_subscriptions(1, 10)
        discoverer.publish(discovery_event("DISCOVERED"))
        await right_pictures(subscription)
        discoverer.publish(discovery_event("LOST"))
        await decoder.reaches("GONE")
        discoverer.publish(discovery_event("RETURNED"))
        await decoder.reaches("RUNNING")
        await right_pictures(subscription, 12)


@pytest.mark.parametrize("side", ["local", "remote"])
def test_an_interface_that_does_not_exist_is_one_clear_error_and_leaves_no_process(domains, side, capfd):
    sides = dict(zip(("remote", "local"), domains, strict=True))
    sides[side] = replace(sides[side], interface="nowhere0")
    before = children()
    with pytest.raises(SfglabError) as error:
        asyncio.run(run_decoder(DecoderConfig(**sides, streams=(STREAM,)), on_status=lambda _: None))
    assert "no network interface 'nowhere0'" in str(error.value)
    assert "\n" not in str(error.value)
    assert "Traceback" not in capfd.readouterr().err
    assert children() == before


async def test_as_a_process_it_reports_its_processes(domains, capfd):
    remote, local = domains
    config = DecoderConfig(remote=remote, local=local, streams=(STREAM,))
    async with process("sfglab.fleet.decoder.node", config) as child:
        child.order(do="list")
        assert (await child.expect("processes", timeout_s=60))["pids"]
    assert (child.status, capfd.readouterr().err) == (0, "")
