"""Count the files of sfglab whose code runs for each message, over the whole path in steady state.

    python benchmarks/message_files.py [--tree PATH]   # of another checkout

Sender and receiver are in domains of their own. Two routers join these with the global domain, all over DDS. They
share one process, so that one profiler sees the calls in all its threads. Of each path 20 messages are sent, one
after the other. A file counts if it is called during each of them.
"""

import argparse
import asyncio
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--tree", type=Path, default=Path(__file__).parents[1], help="Checkout.")
TREE = parser.parse_args().tree.resolve()
sys.path.insert(0, str(TREE))

from sfglab import codecs  # noqa: E402 - of the checkout
from sfglab.bus import Node  # noqa: E402
from sfglab.bus.address import BusAddress  # noqa: E402
from sfglab.component import beside  # noqa: E402
from sfglab.fleet.decoder.pipeline import Outputs, Statistics, run_pipeline  # noqa: E402
from sfglab.fleet.decoder.streams import routes_of_topic  # noqa: E402
from sfglab.fleet.discovery.node import (  # type: ignore[attr-defined]  # noqa: E402 - as earlier versions
    DiscoveryConfig,
    DiscoverySettings,
    run_discoverer,
)
from sfglab.fleet.router.node import RouterConfig, run_router  # noqa: E402
from sfglab.fleet.status.heartbeat import Schedule  # noqa: E402
from sfglab.fleet.status.node import (  # type: ignore[attr-defined]  # noqa: E402 - as earlier versions
    StatusConfig,
    StatusSettings,
    run_status,
)
from sfglab.lab.sources import open_source  # noqa: E402
from sfglab.lab.testbed import held_domains  # noqa: E402
from sfglab.messages import default_message, message_type  # noqa: E402
from sfglab.qos import COMPRESSED_STREAM, SENSOR_DATA  # noqa: E402

MESSAGES = 20
PERIOD_S = 0.1
BEAT_S = 0.3  # period of the heartbeats, of which each interval of this length has one
IMAGE = "sensor_msgs/msg/Image"
CAMERA = "/global/a/camera_front/color/ffmpeg"
called: set[str] = set()  # files that were called since the set was cleared


def profile(frame: FrameType, event: str, _: object) -> None:
    """Note the file of a call, or of a step of a coroutine."""
    if event == "call":
        called.add(frame.f_code.co_filename)


async def show(name: str, most: int, send: Callable[[], Any], receive: Callable[[], Any]) -> None:
    """Send messages, and print the files that each of them needs, and how many there may be."""
    arrived = asyncio.create_task(receive())
    while not arrived.done():
        send()
        await asyncio.sleep(0.2)
    files: set[str] = set()
    await asyncio.sleep(2.0)  # Routers settle.
    for _ in range(MESSAGES):
        called.clear()
        send()
        await receive()
        await asyncio.sleep(PERIOD_S / 2)
        files = files & called if files else called.copy()
    own = f"{TREE / 'sfglab'}/"
    names = sorted(file.removeprefix(own) for file in files if file.startswith(own))
    print(f"{name}: {len(names)} files, at most {most}\n    {', '.join(names)}")


async def show_camera(talker: Node, listener: Node) -> None:
    """Show the files of a frame, from its encoder to a subscriber that reads shared memory."""
    settings = replace(codecs.TABLE_2, encoder="libx264")
    encoder, packet_type = codecs.H264Encoder(settings), message_type(codecs.FFMPEG_PACKET)
    picture, header = open_source("photos").frame().bgr, default_message("std_msgs/msg/Header")
    publisher = talker.create_publisher(packet_type, CAMERA, COMPRESSED_STREAM)
    route = routes_of_topic(CAMERA)[0]
    outputs = Outputs(listener, route, ["shm"])
    decoded = run_pipeline(route, remote=listener, outputs=outputs, counts=Statistics())
    options: dict[str, Any] = {"qos": SENSOR_DATA, "transport": "shm"}
    frames = listener.create_subscription(IMAGE, route.local_topic, **options)

    def send() -> None:
        for packet in encoder.encode(picture):
            fields = asdict(codecs.ffmpeg_packet_fields(packet, settings))
            fields["data"] = np.frombuffer(fields["data"], np.uint8)
            publisher.publish(packet_type(header=header, **fields))

    async with beside(decoded):
        await show("H.264 frame", 15, send, frames.take)


async def show_heartbeat(sender: BusAddress, receiver: BusAddress) -> None:
    """Show the files of a heartbeat, from the status provider to the discoverer."""
    times = Schedule(startup_period_s=BEAT_S, steady_period_s=BEAT_S)
    settings = StatusSettings(agent="a", schedule=times)
    status = StatusConfig(address=sender, settings=settings, detect=False)
    discovery = DiscoveryConfig(address=receiver, settings=DiscoverySettings(agent="b"))
    discoverer = run_discoverer(discovery, lambda _: None, asyncio.Queue())
    async with beside(run_status(status, lambda _: None, asyncio.Queue()), discoverer):
        await show("heartbeat", 16, lambda: None, partial(asyncio.sleep, BEAT_S))


async def main() -> None:
    """Show the files of four messages."""
    with held_domains(3) as domains:
        sender, receiver, shared = (BusAddress(domain_id=one, interface="lo") for one in domains)
        routers = []
        for agent, local in (("a", sender), ("b", receiver)):
            config = RouterConfig(agent=agent, local=local, remote=shared)
            routers.append(run_router(config, lambda _: None))
        async with (
            beside(*routers),
            Node("talker", **sender.options()) as talker,
            Node("listener", **receiver.options()) as listener,
        ):
            transform = default_message("geometry_msgs/msg/TransformStamped")
            transform.header.frame_id, transform.child_frame_id = "odom", "base_link"
            tree = message_type("tf2_msgs/msg/TFMessage")(transforms=[transform])
            text = default_message("std_msgs/msg/String")
            for name, most, topic, message in (
                ("topic of Table 1", 8, "/global/a/state", text),
                ("/tf with prefix", 10, "/tf", tree),
            ):
                publisher = talker.create_publisher(type(message), topic)
                subscription = listener.create_subscription(type(message), topic)
                await show(name, most, partial(publisher.publish, message), subscription.take)
            await show_camera(talker, listener)
            await show_heartbeat(sender, receiver)


if __name__ == "__main__":
    threading.setprofile(profile)
    sys.setprofile(profile)
    asyncio.run(main())
