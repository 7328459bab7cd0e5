"""Publishers of scenes and images, and a sink: ``python -m sfglab.lab.workers.scene_publisher CONFIG``.

Role ``scene`` publishes the messages of a log, those of one time per order. Role ``camera`` publishes an image of
noise at a fixed rate. Role ``sink`` receives what a viewer would.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from sfglab.bus import Node
from sfglab.component import Orders, Reporter, run_component
from sfglab.messages import default_message, serialize, stamp_from_ns
from sfglab.qos import Durability, QoSProfile
from sfglab.record import LogReader

CAMERA_TOPIC = "/global/go2/camera_front/color/image_rect"
CAMERA_HZ = 30.0
CAMERA_SIZE = (640, 360)

_IMAGE = "sensor_msgs/msg/Image"
_MATCH_S = 60.0
#: QoS of the publishers, which is compatible with the requests of all visualizers.
_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=20)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenePublisherConfig:
    """Configuration of the process."""

    role: str  #: Role: ``scene``, ``camera`` or ``sink``.
    domain_id: int = 0  #: DDS domain of scene and camera.
    path: str = ""  #: Path of the scene's log.
    port: int = 0  #: Port of the sink.


def picture() -> Any:
    """Return an image of noise, shape (360, 640, 3), which cannot be compressed."""
    width, height = CAMERA_SIZE
    return np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)


async def _publish_scene(node: Node, path: str, report: Reporter, orders: Orders) -> None:
    with LogReader(path) as log:
        publishers = {
            topic: node.create_publisher(info.type_name, topic, _QOS)
            for topic, info in log.topics.items()
        }
        moments = [list(group) for _, group in groupby(log.messages(), key=lambda m: m.log_time_ns)]
    for publisher in publishers.values():
        await publisher.wait_for_subscriptions(1, timeout_s=_MATCH_S)
    report({"is": "ready", "moments": len(moments)})
    for moment in moments:
        await orders.get()
        for message in moment:
            publishers[message.topic].publish_raw(message.cdr)
        report({"is": "sent", "topics": [message.topic for message in moment]})


def _publish_images(node: Node, report: Reporter) -> None:
    image = default_message(_IMAGE)
    pixels = picture()
    image.width, image.height = CAMERA_SIZE
    image.encoding = "rgb8"
    image.step = pixels[0].nbytes
    image.data = pixels.reshape(-1)
    image.header.stamp = stamp_from_ns(1)
    cdr = serialize(image)
    publisher = node.create_publisher(_IMAGE, CAMERA_TOPIC)
    node.create_timer(1 / CAMERA_HZ, lambda: publisher.publish_raw(cdr))
    report({"is": "ready"})


async def serve(config: ScenePublisherConfig, report: Reporter, orders: Orders) -> None:
    """Run the role until cancelled."""
    if config.role == "sink":
        from sfglab.view.rerunning import rerun

        recording = rerun().RecordingStream("sink")
        recording.serve_grpc(grpc_port=config.port, server_memory_limit="128MB")
        report({"is": "ready"})
        await asyncio.Event().wait()
    async with Node(config.role, domain_id=config.domain_id, interface="lo") as node:
        if config.role == "scene":
            await _publish_scene(node, config.path, report, orders)
        else:
            _publish_images(node, report)
        await asyncio.Event().wait()  # the last messages may need retransmissions


if __name__ == "__main__":
    run_component(ScenePublisherConfig, serve)
