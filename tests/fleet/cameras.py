"""Packets of known pictures, and simulated agents behind their routers."""

from dataclasses import asdict

import numpy as np

from sfglab.codecs import H264Encoder, ffmpeg_packet_fields
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.messages import message_type

STREAM = "/global/go2/camera_front/color/ffmpeg"
LOCAL = "/local/go2/camera_front/color/image_raw"
INFO = "/global/go2/camera_front/color/camera_info"
LOCAL_INFO = "/local/go2/camera_front/color/camera_info"
FFMPEG = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
IMAGE = "sensor_msgs/msg/Image"


def behind_router(world, name, **settings):
    """Return a simulated node in an agent's own domain, and the agent's router to the network's domain 0."""
    place = {"host": name, "domain_id": 7, "reach": "host"}
    near = world.node("router", **place, process="router")
    far = world.node("router", host=name, process="router")
    return world.node(f"of_{name}", **place), Router(
        near, far, RouterSettings(agent=name, **settings)
    )


def rolled(settings, count):
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
