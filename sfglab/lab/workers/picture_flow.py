"""The two ends of a bridge to a viewer: ``python -m sfglab.lab.workers.picture_flow CONFIG``.

Role ``camera`` publishes an image of noise at a fixed rate. Role ``sink`` receives what a viewer would.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

import numpy as np

from sfglab.bus import Node
from sfglab.component import Orders, Reporter, run_component
from sfglab.messages import default_message, serialize, stamp_from_ns

CAMERA_TOPIC = "/global/go2/camera_front/color/image_rect"
CAMERA_HZ = 30.0
CAMERA_SIZE = (640, 360)

_IMAGE = "sensor_msgs/msg/Image"


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureFlowConfig:
    """Configuration of the process."""

    role: str  #: Role: ``camera`` or ``sink``.
    domain_id: int = 0  #: DDS domain of the camera.
    port: int = 0  #: Port of the sink.


def picture() -> Any:
    """Return an image of noise, shape (360, 640, 3), which cannot be compressed."""
    width, height = CAMERA_SIZE
    return np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)


async def _publish_images(domain_id: int, report: Reporter) -> None:
    image = default_message(_IMAGE)
    pixels = picture()
    image.width, image.height = CAMERA_SIZE
    image.encoding = "rgb8"
    image.step = pixels[0].nbytes
    image.data = pixels.reshape(-1)
    image.header.stamp = stamp_from_ns(1)
    cdr = serialize(image)
    async with Node("camera", domain_id=domain_id, interface="lo") as node:
        publisher = node.create_publisher(_IMAGE, CAMERA_TOPIC)
        node.create_timer(1 / CAMERA_HZ, lambda: publisher.publish_raw(cdr))
        report({"is": "ready"})
        await asyncio.Event().wait()


async def _receive(port: int, report: Reporter) -> None:
    from sfglab.view.rerunning import rerun

    recording = rerun().RecordingStream("sink")
    recording.serve_grpc(grpc_port=port, server_memory_limit="128MB")
    report({"is": "ready"})
    await asyncio.Event().wait()


async def serve(config: PictureFlowConfig, report: Reporter, _orders: Orders) -> None:
    """Run the role until cancelled."""
    if config.role == "sink":
        await _receive(config.port, report)
    else:
        await _publish_images(config.domain_id, report)


if __name__ == "__main__":
    run_component(PictureFlowConfig, serve)
