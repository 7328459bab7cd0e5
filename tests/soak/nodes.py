"""Nodes of one agent's user in the soak test: ``nodes.py CONFIG``.

They publish numbered messages, a latched state and the frames of a camera, and they subscribe to
those of the other agents. A number counts periods of the steady clock, which all hosts share and no
fault steps. An order ``come`` has a mark and a time. For each stream, the first message that was
sent after this time is reported as ``{"is": "fresh", "mark", "stream"}``. An order ``tell`` is
answered by the counters of all streams.
"""

import asyncio
import time
from dataclasses import asdict, dataclass

import numpy as np

from sfglab.bus import Node
from sfglab.codecs import FFMPEG_PACKET, H264Encoder, H264Settings, ffmpeg_packet_fields
from sfglab.component import beside, run_component
from sfglab.messages import deserialize, message_type, stamp_from_ns
from sfglab.qos import COMPRESSED_STREAM, LATCHED, SENSOR_DATA, QoSProfile

CAMERAS = ("go2", "spot")
VIEWER = "pc"
AGENTS = (*CAMERAS, VIEWER)
TEXT = "std_msgs/msg/String"
IMAGE = "sensor_msgs/msg/Image"
SIZE = {"width": 64, "height": 32}
RATE_HZ = 10
PERIOD_NS = 10**9 // RATE_HZ
STATE = "state"
QOS = {"count": QoSProfile(depth=100), STATE: LATCHED}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    agent: str
    epoch_ns: int  #: Time of number 0 on the steady clock.


def others_of(agent):
    return [name for name in AGENTS if name != agent]


def streams_of(agent):
    """Return the names of all streams that an agent's nodes receive."""
    names = [f"{what} of {other}" for other in others_of(agent) for what in QOS]
    if agent == VIEWER:
        names += [f"frames of {camera}" for camera in CAMERAS]
    return names


@dataclass
class Stream:
    """Counters of one received stream, and the order that waits for its next message."""

    name: str
    received: int = 0
    repeated: int = 0
    disordered: int = 0
    last: int = -1
    order: dict | None = None


class UserNode:
    """All publishers and subscriptions of one agent's user."""

    def __init__(self, node, config, report):
        self._node = node
        self._agent = config.agent
        self._epoch_ns = config.epoch_ns
        self._report = report
        self._streams = {name: Stream(name) for name in streams_of(config.agent)}
        self._views = []
        self._states = []
        self._publishers = {
            what: node.create_publisher(TEXT, f"/global/{config.agent}/{what}", qos)
            for what, qos in QOS.items()
        }
        for other in others_of(config.agent):
            self._subscribe(other, "count")
        self._come()

    def _note(self, name, number, sent_ns):
        stream = self._streams[name]
        stream.received += 1
        stream.repeated += number == stream.last
        stream.disordered += number < stream.last
        stream.last = max(number, stream.last)
        if stream.order and sent_ns >= stream.order["after_ns"]:
            self._report({"is": "fresh", "mark": stream.order["mark"], "stream": name})
            stream.order = None

    def _subscribe(self, other, what):
        def receive(cdr):
            number, sent_ns = map(int, deserialize(cdr, message_type(TEXT)).data.split())
            self._note(f"{what} of {other}", number, sent_ns)

        topic = f"/global/{other}/{what}"
        return self._node.create_subscription(TEXT, topic, receive, QOS[what], raw=True)

    def _view(self, camera):
        def receive(image):
            number = int(image.header.frame_id.rpartition("_")[2])
            self._note(f"frames of {camera}", number, self._time_ns(number))

        topic = f"/local/{camera}/camera_front/color/image_raw"
        return self._node.create_subscription(IMAGE, topic, receive, SENSOR_DATA, transport="shm")

    def _come(self):
        """Subscribe again to the states as a late joiner, and to frames if that was given up."""
        close_all(self._states)
        self._states = [self._subscribe(other, STATE) for other in others_of(self._agent)]
        if self._agent == VIEWER and not self._views:
            self._views = [self._view(camera) for camera in CAMERAS]

    def obey(self, order):
        match order["do"]:
            case "leave":
                close_all(self._views)
            case "come":
                self._publish(STATE, self._number())
                self._come()
                for stream in self._streams.values():
                    stream.order = order
            case "tell":
                counters = [asdict(stream) for stream in self._streams.values()]
                self._report({"is": "told", "streams": counters})

    def _time_ns(self, number):
        return self._epoch_ns + number * PERIOD_NS

    def _number(self):
        return (time.monotonic_ns() - self._epoch_ns) // PERIOD_NS

    def _publish(self, what, number):
        message = message_type(TEXT)(data=f"{number} {time.monotonic_ns()}")
        self._publishers[what].publish(message)

    async def send(self):
        """Publish all streams; a number that is more than one second late is left out."""
        camera = None
        if self._agent in CAMERAS:
            camera = Camera(self._node, self._agent)
        number = self._number()
        while True:
            number = max(number + 1, self._number() - RATE_HZ)
            await asyncio.sleep((self._time_ns(number) - time.monotonic_ns()) / 1e9)
            self._publish("count", number)
            if number % (2 * RATE_HZ) == 0:
                self._publish(STATE, number)
            if camera is not None:
                camera.publish(number)


class Camera:
    """Publishes frames in H.264; the frame id in the header contains the number."""

    def __init__(self, node, agent):
        rate = {"fps": RATE_HZ, "gop": 2 * RATE_HZ, "bitrate_bps": 500_000}
        self._settings = H264Settings(encoder="libx264", **SIZE, **rate)
        self._encoder = H264Encoder(self._settings)
        topic = f"/global/{agent}/camera_front/color/ffmpeg"
        self._publisher = node.create_publisher(FFMPEG_PACKET, topic, COMPRESSED_STREAM)

    def publish(self, number):
        frame = np.full((SIZE["height"], SIZE["width"], 3), number % 200, np.uint8)
        stamp = stamp_from_ns(time.time_ns())
        header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id=f"camera_{number}")
        for packet in self._encoder.encode(frame):
            fields = asdict(ffmpeg_packet_fields(packet, self._settings))
            fields["data"] = np.frombuffer(fields["data"], np.uint8)
            self._publisher.publish(message_type(FFMPEG_PACKET)(header=header, **fields))


def close_all(subscriptions):
    while subscriptions:
        subscriptions.pop().close()


async def serve(config, report, orders):
    """Publish, receive and obey orders until the task is cancelled."""
    domain = AGENTS.index(config.agent) + 1
    async with Node("user", domain_id=domain, interface="lo") as node:
        user = UserNode(node, config, report)
        async with beside(user.send()):
            report({"is": "ready"})
            while True:
                user.obey(await orders.get())


if __name__ == "__main__":
    run_component(Config, serve)
