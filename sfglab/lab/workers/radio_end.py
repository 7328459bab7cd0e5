"""One end of a link over a radio: ``python -m sfglab.lab.workers.radio_end CONFIG``.

The robot sends samples, the heartbeats of two agents, latched values and, if it films, a camera's stream. The
station receives them. With Zenoh the station is the hub, and the robot its client. Orders are ``{"do": ...}`` with the
name of a method of `Robot` or `Station`.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sfglab.bus import Node
from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.bus.zenoh.backend import ZenohBackend
from sfglab.codecs import (
    FFMPEG_PACKET,
    TABLE_2,
    CodecError,
    H264Encoder,
    ffmpeg_packet_fields,
    image_decoder,
)
from sfglab.component import Orders, Reporter, run_component
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.lifecycle import Announced
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.hub import hub_config
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.fleet.status.node import StatusProvider
from sfglab.lab.hosts.host import INTERFACE
from sfglab.lab.sources import open_source
from sfglab.messages import message_type, ns_from_stamp
from sfglab.qos import COMPRESSED_STREAM, DEFAULT, LATCHED, QoSProfile, Reliability
from sfglab.spatial.poses import header_msg
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.fleet.discovery.registry import Order

Way = Literal["dds_reliable", "dds_best_effort", "zenoh_quic", "zenoh_tcp"]
AGENTS = {"startup": Schedule(startup_s=3600), "steady": Schedule(startup_s=0)}
"""Agents with their heartbeats: one of them stays in the startup phase, the other begins with the steady state."""
HUB = "10.77.0.2"  #: Address of the station, the first host of the network, to which Zenoh's client connects.
PERIOD_S = 0.02  #: Period of the samples, s.
FRESH_S = 0.1  #: Age up to which a sample or a picture is fresh, s.

_TEXT = "std_msgs/msg/String"
_SAMPLE = "x" * 55  # 64 bytes of CDR
_SAMPLES = "/global/robot/samples"
_VALUES = "/global/robot/value"
_STREAM = "/global/robot/camera_front/color/ffmpeg"
_REQUESTS = "/global/robot/camera_front/color/key_frame"


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioEndConfig:
    """Configuration of one end of a link."""

    is_robot: bool  #: Whether the end is the robot.
    way: Way  #: Middleware, and its reliability or transport.
    certificates: str  #: Folder with the certificate ``hub`` of both ends, for QUIC.
    films: bool  #: Whether the robot has a camera.

    def node(self) -> Node:
        """Return the node, which is not started."""
        name = "robot" if self.is_robot else "station"
        middleware, _, link = self.way.partition("_")
        if middleware == "dds":
            return Node(name, domain_id=0, interface=INTERFACE, multicast="spdp")
        certificates = self.certificates if link == "quic" else ""
        if not self.is_robot:
            hub = hub_config(HUB, certificates=certificates)
            return Node(name, join=partial(ZenohBackend, hub))
        client = ZenohAddress(hubs=(HUB,), certificates=certificates, name="hub")
        return Node(name, **client.options())

    def qos(self, profile: QoSProfile) -> QoSProfile:
        """Return a profile with the reliability of samples and of the camera's stream."""
        is_best_effort = self.way == "dds_best_effort"
        reliability = Reliability.BEST_EFFORT if is_best_effort else Reliability.RELIABLE
        return replace(profile, reliability=reliability)


class Robot:
    """The robot."""

    def __init__(self, node: Node, config: RadioEndConfig, tasks: asyncio.TaskGroup) -> None:
        self._node = node
        self._text = message_type(_TEXT)
        self._values = node.create_publisher(_TEXT, _VALUES, LATCHED)
        self._is_key_wanted = False
        samples = node.create_publisher(_TEXT, _SAMPLES, config.qos(DEFAULT))
        node.create_timer(PERIOD_S, partial(samples.publish, self._text(data=_SAMPLE)))
        for agent, schedule in AGENTS.items():
            settings = StatusSettings(agent=agent, schedule=schedule)
            tasks.create_task(StatusProvider(node, settings).run())
        if config.films:
            tasks.create_task(self._film(config.qos(COMPRESSED_STREAM)))

    async def latch(self) -> None:
        """Publish a latched value."""
        self._values.publish(self._text(data="latched"))

    async def _film(self, qos: QoSProfile) -> None:
        packet_type = message_type(FFMPEG_PACKET)
        encoder = H264Encoder(replace(TABLE_2, encoder="libx264"))
        source = open_source("photos")
        publisher = self._node.create_publisher(FFMPEG_PACKET, _STREAM, qos)
        self._requests = self._node.create_subscription(_TEXT, _REQUESTS, self._want_key)
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            image = source.frame().bgr
            due_s += 1 / TABLE_2.fps
            await asyncio.sleep(due_s - loop.time())
            header = header_msg("camera_front", time.time_ns())
            [packet] = encoder.encode(image, force_key=self._is_key_wanted)
            self._is_key_wanted = False
            fields = asdict(ffmpeg_packet_fields(packet, TABLE_2))
            fields["data"] = np.frombuffer(packet.data, np.uint8)
            publisher.publish(packet_type(header=header, **fields))

    def _want_key(self, _: Any) -> None:
        self._is_key_wanted = True


class Station:
    """The station."""

    def __init__(
        self, node: Node, config: RadioEndConfig, tasks: asyncio.TaskGroup, report: Reporter
    ) -> None:
        self._report = report
        #: Streams with the times of sending and of arrival, ns, of what has arrived since the last order to begin.
        self._streams: dict[str, list[tuple[int, int]]] = {"samples": []}
        if config.films:
            self._streams["pictures"] = []
        self._latched_ns: list[int] = []
        self._events: list[tuple[str, str, int]] = []  # event, agent and time, ns
        self._may_ask = False
        self._decoder = image_decoder(FFMPEG_PACKET, "h264")
        self._requests = node.create_publisher(_TEXT, _REQUESTS)
        self._discoverer = AgentDiscoverer(
            node, DiscoverySettings(agent="station"), on_event=self._note
        )
        stream_qos = config.qos(COMPRESSED_STREAM)
        self._subscriptions = (
            node.create_subscription(_TEXT, _VALUES, self._take_value, LATCHED),
            node.create_subscription(FFMPEG_PACKET, _STREAM, self._take_packet, stream_qos),
        )
        tasks.create_task(self._discoverer.run())
        tasks.create_task(self._take_samples(node, config.qos(DEFAULT)))

    async def begin(self, *, requests: bool) -> None:
        """Report ``begun`` when all is fresh and all agents are present, and forget all but the newest of each stream.

        From then on, key frames are requested if `requests` is set.
        """
        while not (self._is_whole() and all(map(_is_fresh, self._streams.values()))):  # noqa: ASYNC110 - several sources
            await asyncio.sleep(0.02)
        for stream in self._streams.values():
            del stream[:-1]
        self._latched_ns.clear()
        self._events.clear()
        self._may_ask = requests
        self._report({"is": "begun"})

    async def collect(self) -> None:
        """Report ``collected``, with what has arrived since the order to begin."""
        found = {"latched_ns": self._latched_ns, "events": self._events}
        streams = {"pictures": [], **self._streams}
        self._report({"is": "collected", "whole": self._is_whole(), **found, **streams})

    def _is_whole(self) -> bool:
        states = self._discoverer.states.values()
        return sum(state.announced is Announced.PRESENT for state in states) == len(AGENTS)

    async def _take_samples(self, node: Node, qos: QoSProfile) -> None:
        subscription = node.create_subscription(_TEXT, _SAMPLES, qos=qos, raw=True)
        while True:
            _, info = await subscription.take_with_info()
            times_ns = (info.source_timestamp_ns, info.received_timestamp_ns)
            self._streams["samples"].append(times_ns)

    def _take_value(self, _: Any) -> None:
        self._latched_ns.append(time.time_ns())

    def _note(self, order: Order) -> None:
        self._events.append((order.event, order.agent, time.time_ns()))

    def _take_packet(self, message: Any) -> None:
        """Decode a packet, and show its picture if no packet since the last key frame is missing."""
        is_intact = False
        with suppress(CodecError):
            is_intact = any(image.intact for image in self._decoder.feed(message))
        if is_intact:
            times_ns = (ns_from_stamp(message.header.stamp), time.time_ns())
            self._streams["pictures"].append(times_ns)
        elif self._may_ask:
            self._requests.publish(message_type(_TEXT)(data="key frame"))


def _is_fresh(stream: list[tuple[int, int]]) -> bool:
    """Return whether the newest sample or picture of a stream was sent just now."""
    newest_ns = max((sent_ns for sent_ns, _ in stream), default=0)
    return time.time_ns() - newest_ns < FRESH_S * NS_PER_S


async def serve(config: RadioEndConfig, report: Reporter, orders: Orders) -> None:
    """Run one end of a link and follow orders until cancelled."""
    async with config.node() as node, asyncio.TaskGroup() as tasks:
        end: Any = Robot(node, config, tasks) if config.is_robot else None
        end = end or Station(node, config, tasks, report)
        report({"is": "ready"})
        while True:
            order = await orders.get()
            await getattr(end, order.pop("do"))(**order)


if __name__ == "__main__":
    run_component(RadioEndConfig, serve)
