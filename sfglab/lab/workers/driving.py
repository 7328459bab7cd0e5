"""A node of the driving application as a process: ``python -m sfglab.lab.workers.driving CONFIG``.

The process runs the node of `sfglab.soc.driving` whose name is in its configuration. Messages carry
the time at which the compensation received its image. Topic A exists twice, and each image takes one of
them at random: ``/A/software`` over DDS, one copy per subscriber, and ``/A/gateway``, one copy in shared
memory.

Orders: ``go`` starts the camera, which reports ``over`` at its end. ``stop`` makes a node report
``stopped`` with its ``frames``: the compensation's start (ns) and mapping, or the lane control's start
and end (ns).
"""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.bus import Node, Subscription
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Reporter, beside, run_component
from sfglab.messages import default_message, ns_from_stamp, stamp_from_ns
from sfglab.soc.driving import CHAIN, SHARED_TOPIC, Camera, Stack, run_lap
from sfglab.soc.driving.nodes import Lane, blur, compensate, fit_lane, lane_mask
from sfglab.soc.driving.pose import Pose

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import Transport

WIDTH = 640  #: Width of the camera's images, pixels; they have the size of topic A in the graph.
HEIGHT = 480  #: Height of the camera's images, pixels.
CAMERA = "camera"  #: Name of the node that publishes images.
SOFTWARE = "software"  #: Mapping of topic A in the first version of the paper.
GATEWAY = "gateway"  #: Mapping of topic A in the second version of the paper.
TRANSPORTS: dict[str, Transport] = {SOFTWARE: "dds", GATEWAY: "shm"}  #: Transport by mapping.
_LANE = "/lane"  #: Topic of the processing chain that goes to software.
_MATCH_S = 60.0
_IMAGES_S = 2.0  #: Duration of the drive whose images the camera publishes, s.


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingNodeConfig:
    """Configuration of the process of one node of the driving application."""

    node: str  #: Name of the node.
    subscribes: str  #: Topic that it processes; empty: none.
    publishes: str  #: Topic that it publishes.
    readers: int  #: Number of subscribers of that topic.
    address: BusAddress  #: Address on the bus.
    rate_hz: float  #: Frame rate of the camera, Hz.
    live_s: float  #: Duration of the camera's images, s.
    seed: int  #: Seed of the town and of the sampled mappings.


def _endpoints(create: Callable[..., Any], topic: str) -> dict[str, Any]:
    """Create the publishers or subscriptions of a topic, by mapping."""
    if not topic:
        return {}
    mappings = [GATEWAY]
    type_ = "sensor_msgs/msg/Image"
    if topic == SHARED_TOPIC:
        mappings = list(TRANSPORTS)
    if topic == _LANE:
        mappings = [SOFTWARE]
        type_ = "geometry_msgs/msg/Vector3Stamped"
    found = {}
    for mapping in mappings:
        found[mapping] = create(type_, f"{topic}/{mapping}", transport=TRANSPORTS[mapping])
    return found


def _callbacks(stack: Stack) -> dict[str, Callable[[Any], Any]]:
    """Return the function of each node on the content of a message."""
    return {
        "compensation": compensate,
        "gaussian_blur": blur,
        "lane_planner": lambda image: lane_mask(image, stack.camera),
        "polyfit": fit_lane,
        "red_light_detection": stack.red.detect,
        "green_light_detection": stack.green.detect,
        "visual_odometry": stack.odometry.update,
        "lane_control": lambda lane: stack.control.step(lane, Pose()),
    }


def _to_message(content: Any, stamp_ns: int) -> Any:
    """Return an image, or a lane (NaN: no lane), as a message."""
    if isinstance(content, np.ndarray):
        message = default_message("sensor_msgs/msg/Image")
        message.height, message.width = content.shape[:2]
        message.data = content.reshape(-1)
    else:
        message = default_message("geometry_msgs/msg/Vector3Stamped")
        lane = content or Lane(offset_m=math.nan, slope=0.0, bend_per_m=0.0)
        message.vector.x = lane.offset_m
        message.vector.y = lane.slope
        message.vector.z = lane.bend_per_m
    message.header.stamp = stamp_from_ns(stamp_ns)
    return message


def _from_message(message: Any) -> Any:
    """Return the content of a message: an image with one or three channels, or a lane or None."""
    if hasattr(message, "data"):
        return np.squeeze(message.data.reshape(message.height, message.width, -1))
    vector = message.vector
    if math.isnan(vector.x):
        return None
    return Lane(offset_m=vector.x, slope=vector.y, bend_per_m=vector.z)


async def _publish_images(config: DrivingNodeConfig, images: list[Any], publisher: Any) -> None:
    """Publish images at the camera's rate, forwards and backwards, so that successive images are similar."""
    there_and_back = [*images, *images[-2:0:-1]]
    start_s = time.monotonic()
    for number in range(round(config.live_s * config.rate_hz)):
        image = there_and_back[number % len(there_and_back)]
        publisher.publish(_to_message(image, 1))  # the compensation sets the stamp
        await asyncio.sleep(start_s + (number + 1) / config.rate_hz - time.monotonic())


async def _process(
    node: str,
    subscription: Subscription,
    publishers: dict[str, Any],
    compute: Callable[[Any], Any],
    note: Callable[[int], str],
) -> None:
    """Process messages one after the other; `note` returns the mapping that the result is published by."""
    async for message in subscription:
        stamp_ns = time.monotonic_ns() if node == CHAIN[0] else ns_from_stamp(message.header.stamp)
        result = compute(_from_message(message))
        del message  # this releases its place in shared memory
        mapping = note(stamp_ns)
        if publishers:
            publishers[mapping].publish(_to_message(result, stamp_ns))


async def serve(config: DrivingNodeConfig, report: Reporter, orders: Orders) -> None:
    """Run the configured node of the application until cancelled; reports have its times."""
    cv2.setNumThreads(1)  # as the only executor of a node does
    name = config.node
    stack = Stack(Camera(width=WIDTH, height=HEIGHT))
    rng = np.random.default_rng(config.seed)
    frames: list[tuple[int, str | int]] = []
    images: list[Any] = []

    def note(stamp_ns: int) -> str:
        if name == CHAIN[0]:
            mapping = str(rng.choice(list(TRANSPORTS)))
            frames.append((stamp_ns, mapping))
            return mapping
        frames.append((stamp_ns, time.monotonic_ns()))
        return next(iter(publishers), "")

    async with Node(name, **config.address.options()) as bus:
        # Results of odometry, control and the detection of lights go to no node of the chain.
        published = config.publishes if name in {CAMERA, *CHAIN[:-1]} else ""
        publishers = _endpoints(bus.create_publisher, published)
        subscriptions = _endpoints(bus.create_subscription, config.subscribes)
        if name == CAMERA:
            run_lap(
                config.seed,
                stack=stack,
                timeout_s=_IMAGES_S,
                watch=lambda moment: images.append(moment.frame.image),
            )
        for publisher in publishers.values():
            await publisher.wait_for_subscriptions(config.readers, _MATCH_S)
        report({"is": "ready"})
        callbacks = _callbacks(stack)
        tasks = [
            _process(name, subscription, publishers, callbacks[name], note)
            for subscription in subscriptions.values()
        ]
        async with beside(*tasks):
            while (await orders.get())["do"] == "go":
                await _publish_images(config, images, publishers[GATEWAY])
                report({"is": "over"})
            report({"is": "stopped", "frames": frames})
            await asyncio.Event().wait()


if __name__ == "__main__":
    run_component(DrivingNodeConfig, serve)
