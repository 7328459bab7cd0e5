"""A camera of known pictures, what a decoder tells, and simulated agents behind their routers."""

import asyncio
from dataclasses import asdict

import numpy as np
from waiting import until

from sfglab.bus import Node
from sfglab.codecs import H264Encoder, H264Settings, ffmpeg_packet_fields
from sfglab.component import beside
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.messages import message_type, stamp_from_ns
from sfglab.qos import QoSProfile, Reliability

STREAM = "/global/go2/camera_front/color/ffmpeg"
LOCAL = "/local/go2/camera_front/color/image_raw"
INFO = "/global/go2/camera_front/color/camera_info"
LOCAL_INFO = "/local/go2/camera_front/color/camera_info"
FFMPEG = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
IMAGE = "sensor_msgs/msg/Image"


def behind_router(world, name: str, **settings):
    """Return a simulated node in an agent's own domain, and the agent's router to the network's domain 0."""
    place = {"host": name, "domain_id": 7, "reach": "host"}
    near = world.node("router", **place, process="router")
    far = world.node("router", host=name, process="router")
    return world.node(f"of_{name}", **place), Router(
        near, far, RouterSettings(agent=name, **settings)
    )


def rolled(settings: H264Settings, count: int) -> list:
    """Return the packets of a picture that moves, as fields of messages."""
    size = settings.height // 8, settings.width // 8, 3
    still = np.random.default_rng(0).integers(0, 255, size, np.uint8).repeat(8, 0).repeat(8, 1)
    encoder = H264Encoder(settings)
    frames = [
        frame for n in range(count) for frame in encoder.encode(np.roll(still, 3 * n, axis=1))
    ]
    return [ffmpeg_packet_fields(frame, settings) for frame in frames]


def packet_message(fields, header):
    values = asdict(fields) | {"data": np.frombuffer(fields.data, np.uint8)}
    return message_type(FFMPEG)(header=header, **values)


class Camera:
    """Publishes a flat picture whose blue level is the stamp's number of seconds, at 50 frames a second."""

    height, width = 192, 320

    def __init__(self, node: Node) -> None:
        qos = QoSProfile(reliability=Reliability.BEST_EFFORT, depth=60)
        self.publisher = node.create_publisher(FFMPEG, STREAM, qos)
        self.gop = 5
        self.level = 0

    async def shoot(self) -> None:
        size = {"width": self.width, "height": self.height}
        settings = H264Settings(
            **size, fps=50, bitrate_bps=1_000_000, gop=self.gop, encoder="libx264"
        )
        encoder = H264Encoder(settings)
        while True:
            self.level = self.level % 200 + 1
            stamp = stamp_from_ns(self.level * 10**9)
            header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id="camera")
            for packet in encoder.encode(self.picture()):
                self.publisher.publish(
                    packet_message(ffmpeg_packet_fields(packet, settings), header)
                )
            await asyncio.sleep(0.02)

    def picture(self) -> np.ndarray:
        return np.full((self.height, self.width, 3), self.level, dtype=np.uint8)

    def running(self):
        return beside(self.shoot())

    async def shot(self, frames: int) -> None:
        """Wait for so many more pictures."""
        last = self.level + frames
        await until(lambda: self.level >= last)


class Decoder:
    """A running decoder with the history of every stream's states."""

    def __init__(self) -> None:
        self.pool = None
        self.ready = asyncio.Event()
        self.status = {}
        self.states = {}

    def note(self, status) -> None:
        self.status[status.local_topic] = status
        history = self.states.setdefault(status.local_topic, [])
        if history[-1:] != [status.state]:
            history.append(status.state)

    def is_ready(self, pool) -> None:
        self.pool = pool
        self.ready.set()

    async def reaches(self, state: str) -> None:
        await until(lambda: LOCAL in self.status and self.status[LOCAL].state == state)
