"""Both ends of a bridge to a viewer: ``python -m sfglab.lab.workers.picture_flow CONFIG``.

The process publishes an image of noise at a fixed rate, and receives in place of a viewer what is drawn of it.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.component import Orders, Reporter, run_component
from sfglab.messages import message_type, serialize
from sfglab.spatial.poses import header_msg

if TYPE_CHECKING:
    from numpy.typing import NDArray

CAMERA_TOPIC = "/global/go2/camera_front/color/image_rect"
CAMERA_HZ = 30.0
CAMERA_SIZE = (640, 360)

IMAGE = "sensor_msgs/msg/Image"


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureFlowConfig:
    """Configuration of the process that publishes an image and receives Rerun data."""

    domain_id: int  #: DDS domain of the camera.
    port: int  #: Port of the sink.


def picture() -> NDArray[np.uint8]:
    """Return an image of noise, shape (360, 640, 3), which cannot be compressed."""
    width, height = CAMERA_SIZE
    return np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)


def image_message(array: NDArray[Any], encoding: str, header: Any) -> Any:
    """Return an ``Image`` of pixels, shape (H, W) or (H, W, channels)."""
    return message_type(IMAGE)(
        header=header,
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=array[0].nbytes,
        data=np.ascontiguousarray(array).reshape(-1).view(np.uint8),
    )


async def serve(config: PictureFlowConfig, report: Reporter, _orders: Orders) -> None:
    """Publish an image at a fixed rate, and run a server that receives Rerun data, until cancelled."""
    from sfglab.view.rerunning import rerun

    sink = rerun().RecordingStream("sink")
    sink.serve_grpc(grpc_port=config.port, server_memory_limit="128MB")
    cdr = serialize(image_message(picture(), "rgb8", header_msg("", 1)))
    async with Node("camera", domain_id=config.domain_id, interface="lo") as node:
        publisher = node.create_publisher(IMAGE, CAMERA_TOPIC)
        node.create_timer(1 / CAMERA_HZ, lambda: publisher.publish_raw(cdr))
        report({"is": "ready"})
        await asyncio.Event().wait()


if __name__ == "__main__":
    run_component(PictureFlowConfig, serve)
