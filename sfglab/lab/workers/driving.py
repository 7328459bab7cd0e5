"""A node of the driving application as a process of its own: ``python -m sfglab.lab.workers.driving CONFIG``.

It hears, says and does what `sfglab.soc.driving.NODES` have of the chain. Messages carry the time at which the
compensation had its picture. Topic A is there twice, and which way a picture takes is drawn: ``/A/software`` by
DDS, a copy for each reader, and ``/A/gateway``, one copy in shared memory. Orders: ``go`` to the camera, which
reports ``over``; ``stop``, upon which a node reports ``stopped`` with its ``frames``: the compensation's start
(ns) and mapping, the lane control's start and end.
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
from sfglab.soc.driving import CHAIN, NODES, SHARED_TOPIC, Camera, Frame, Rules, Stack, run_lap
from sfglab.soc.driving.nodes import Lane, blur, compensate, fit_lane, lane_mask
from sfglab.soc.driving.odometry import Pose
from sfglab.soc.driving.town import LANE_M

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import Transport

NAMES = tuple(ports.node for ports in NODES if ports.node != "car")  #: Of the processes.
#: How a topic goes, by its mapping.
WAYS: dict[str, Transport] = {"software": "dds", "gateway": "shm"}
_LANE = "/lane"  # heard in software
_READERS = 4  # of topic A
_MATCH_S, _PICTURES_S = 60.0, 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingNodeConfig:
    """What a node is told."""

    node: str  #: One of `NAMES`.
    address: BusAddress  #: Where it is on the bus.
    width: int  #: Of the camera's images, pixels.
    height: int  #: The same.
    rate_hz: float  #: Of the camera.
    live_s: float  #: How long it shoots.
    seed: int  #: Of the town, and of the drawn mappings.


def _ends(create: Callable[..., Any], topics: tuple[str, ...]) -> dict[str, Any]:
    """Create a topic's publishers or subscriptions, by what it is mapped to; topic A is mapped to both."""
    found = {}
    for topic in topics[:1]:
        type_ = "geometry_msgs/msg/Vector3Stamped" if topic == _LANE else "sensor_msgs/msg/Image"
        mapped = WAYS if topic == SHARED_TOPIC else ["software" if topic == _LANE else "gateway"]
        for way in mapped:
            found[way] = create(type_, f"{topic}/{way}", transport=WAYS[way])
    return found


def _does(stack: Stack) -> dict[str, Callable[[Any], Any]]:
    """Return what each node makes of a message."""
    return {
        "compensation": compensate,
        "gaussian_blur": blur,
        "lane_planner": lambda image: lane_mask(image, stack.view),
        "polyfit": lambda mask: fit_lane(mask, stack.view, lane_m=LANE_M),
        "red_light_detection": stack.red.see,
        "green_light_detection": stack.green.see,
        "visual_odometry": stack.odometry.see,
        "lane_control": lambda lane: stack.control.step(lane, Pose()),
    }


def _message(said: Any, stamp_ns: int) -> Any:
    """Return an image, or what the polyfit says (NaN: no lane), as a message."""
    if isinstance(said, np.ndarray):
        message = default_message("sensor_msgs/msg/Image")
        (message.height, message.width), message.data = said.shape[:2], said.reshape(-1)
    else:
        message = default_message("geometry_msgs/msg/Vector3Stamped")
        lane, at = said or Lane(offset_m=math.nan, slope=0.0, bend_per_m=0.0), message.vector
        at.x, at.y, at.z = lane.offset_m, lane.slope, lane.bend_per_m
    message.header.stamp = stamp_from_ns(stamp_ns)
    return message


def _said(message: Any) -> Any:
    """Return what a message holds: an image of one or three channels, or a lane; None without one."""
    if hasattr(message, "data"):
        return np.squeeze(message.data.reshape(message.height, message.width, -1))
    at = message.vector
    return None if math.isnan(at.x) else Lane(offset_m=at.x, slope=at.y, bend_per_m=at.z)


async def _shoot(config: DrivingNodeConfig, pictures: list[Any], publisher: Any) -> None:
    """Publish pictures at the camera's rate, forth and back, so that none is far from the one before."""
    there_and_back = [*pictures, *pictures[-2:0:-1]]
    start_s = time.monotonic()
    for number in range(round(config.live_s * config.rate_hz)):
        publisher.publish(_message(there_and_back[number % len(there_and_back)], 1))
        await asyncio.sleep(start_s + (number + 1) / config.rate_hz - time.monotonic())


async def _listen(
    node: str, heard: Subscription, said: dict[str, Any], does: Any, note: Any
) -> None:
    """Work on what is heard, one message after the other."""
    async for message in heard:
        stamp_ns = time.monotonic_ns() if node == CHAIN[0] else ns_from_stamp(message.header.stamp)
        made = does(_said(message))
        del message  # its place in shared memory is free
        way = note(stamp_ns)
        if said:
            said[way if way in said else next(iter(said))].publish(_message(made, stamp_ns))


async def serve(config: DrivingNodeConfig, report: Reporter, orders: Orders) -> None:
    """Be a node until cancelled."""
    cv2.setNumThreads(1)  # as a node's one executor
    name, frames = config.node, []
    rng = np.random.default_rng(config.seed)
    stack, pictures = Stack(Camera(width=config.width, height=config.height)), []
    ports = next(ports for ports in NODES if ports.node == name)

    def keep(_s: float, _car: Any, frame: Frame) -> None:
        pictures.append(frame.image)

    def note(stamp_ns: int) -> str:
        way = str(rng.choice(list(WAYS))) if name == CHAIN[0] else ""
        frames.append((stamp_ns, way or time.monotonic_ns()))
        return way

    async with Node(name, **config.address.options()) as bus:
        # What the lights' detections and the odometry say is no part of the chain.
        said = _ends(
            bus.create_publisher, ports.publishes if name in {NAMES[0], *CHAIN[:-1]} else ()
        )
        heard = _ends(bus.create_subscription, ports.subscribes)
        if name == NAMES[0]:
            run_lap(config.seed, stack=stack, rules=Rules(timeout_s=_PICTURES_S), watch=keep)
        for publisher in said.values():
            await publisher.wait_for_subscriptions(_READERS if len(said) > 1 else 1, _MATCH_S)
        report({"is": "ready"})
        does = _does(stack)[name] if heard else None
        async with beside(*(_listen(name, one, said, does, note) for one in heard.values())):
            while (await orders.get())["do"] == "go":
                await _shoot(config, pictures, said["gateway"])
                report({"is": "over"})
            report({"is": "stopped", "frames": frames})
            await asyncio.Event().wait()


if __name__ == "__main__":
    run_component(DrivingNodeConfig, serve)
