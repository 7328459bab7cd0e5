"""Users' nodes on an agent that faults happen to: ``python -m sfglab.lab.workers.soaked CONFIG``.

They publish numbered messages, a latched state and the pictures of a camera, consume those of the other agents,
and record what they hear on a disk of their own, which can be filled. Numbers
are those of periods of the machine's steady clock, which no step of an agent's clock moves and all test hosts
share: what was sent after a fault is known by its number. Reports, beside ``ready``: ``{"is": "fresh", "mark",
"stream", "t_ns"}`` for the first of each stream that was sent after a mark, ``{"is": "wrong", "stream", "t_ns",
"number", "last"}`` for a picture or number that does not come after the last, ``{"is": "told", "streams"}``.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node, Subscription
from sfglab.bus.address import BusAddress
from sfglab.codecs import FFMPEG_PACKET, H264Encoder, H264Settings, ffmpeg_packet_fields
from sfglab.component import Orders, Report, Reporter, beside, run_component
from sfglab.errors import SfglabError
from sfglab.lab.framenumber import read_number_flat, stamp_number
from sfglab.lab.hosts.host import INTERFACE
from sfglab.messages import deserialize, message_type, stamp_from_ns
from sfglab.qos import COMPRESSED_STREAM, LATCHED, SENSOR_DATA, QoSProfile
from sfglab.record import LogWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

TEXT, IMAGE = "std_msgs/msg/String", "sensor_msgs/msg/Image"
WIDTH, HEIGHT = 544, 32  #: Size of pictures, the least that shows a number, pixels.
RATE_HZ = 10  #: Of pictures and numbered messages.
NUMBERED, STATE = QoSProfile(depth=100), "state"


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakedConfig:
    """What the nodes of an agent are told."""

    agent: str  #: Its name.
    address: BusAddress  #: Its own domain.
    others: tuple[str, ...]  #: The other agents, whose numbered messages and states are consumed.
    epoch_ns: int  #: The instant of number 0, nanoseconds of the steady clock.
    shoots: bool  #: Whether it has a camera.
    views: tuple[str, ...]  #: Agents whose camera is looked at.
    disk: str  #: Folder of a small disk of its own, on which is recorded; empty: nothing is.

    @property
    def streams(self) -> list[str]:
        """What it consumes, by name."""
        heard = [f"{what} of {other}" for other in self.others for what in ("count", STATE)]
        return (
            heard
            + [f"pictures of {other}" for other in self.views]
            + ["recorded"] * bool(self.disk)
        )


def stream_topic(agent: str) -> str:
    """Return the compressed topic of an agent's camera."""
    return f"/global/{agent}/camera_front/color/ffmpeg"


def fleet(names: Sequence[str], cameras: Sequence[str]) -> dict[str, Any]:
    """Return the fleet file of some agents, with a domain each from 1 on, some of them with a camera."""
    stream = {
        "type": FFMPEG_PACKET,
        "codec": "h264",
        "width": WIDTH,
        "height": HEIGHT,
        "rate_hz": RATE_HZ,
    }
    where: dict[str, Any] = {"local_interface": "lo", "global_interface": INTERFACE}
    agents = {name: {"domain": domain, **where} for domain, name in enumerate(names, 1)}
    for name in cameras:
        streams = [stream | {"topic": stream_topic(name)}]
        agents[name] |= {"sensors": [{"name": "camera_front", "streams": streams}]}
    return {"fleet": "soak", "global": {"domain": 0}, "policy": "table-1", "agents": agents}


@dataclass(slots=True)
class Stream:
    """What has arrived of one stream, which is told when the first comes that was sent after a mark."""

    name: str  #: What and whose.
    report: Reporter  #: Takes what is to be reported.
    received: int = 0  #: How many.
    repeated: int = 0  #: How many came again.
    disordered: int = 0  #: How many came after a later one.
    damaged: int = 0  #: How many pictures show another number than they have: decoded after a loss.
    _last: int = -1
    _mark: tuple[int, int] | None = None

    def mark(self, mark: int, after_ns: int) -> None:
        """Wait for the first that was sent after a time of the steady clock."""
        self._mark = mark, after_ns

    def note(self, number: int, sent_ns: int) -> None:
        """Take one."""
        self.received += 1
        self.repeated += number == self._last
        self.disordered += number < self._last
        if number <= self._last and not self.name.startswith(
            STATE
        ):  # which may, when it is asked for anew
            self._say("wrong", number=number, last=self._last)
        self._last = max(number, self._last)
        if self._mark and sent_ns >= self._mark[1]:
            self._say("fresh", mark=self._mark[0])
            self._mark = None

    def _say(self, what: str, **values: int) -> None:
        self.report({"is": what, "stream": self.name, "t_ns": time.monotonic_ns(), **values})


@dataclass(slots=True)
class Recorder:
    """Records messages into logs on a small disk; after one that could not be finished comes another."""

    folder: Path  #: Where.
    stream: Stream  #: Takes what the disk has.
    _log: LogWriter | None = None
    _pending_ns: list[int] = field(default_factory=list)

    def write(self, topic: str, cdr: bytes, sent_ns: int) -> None:
        """Record a message; what a full disk does not take is lost, and so is the log's last chunk."""
        try:
            if self._log is None:
                self._log = LogWriter(self.folder / f"{sent_ns}.mcap", overwrite=True)
            self._log.write_raw(topic, TEXT, cdr, log_time_ns=sent_ns)
            self._pending_ns.append(sent_ns)
            if sent_ns - self._pending_ns[0] > 0.5e9:
                self._log.flush()
                for each_ns in self._pending_ns:
                    self.stream.note(self.stream.received, each_ns)
                self._pending_ns.clear()
        except (OSError, SfglabError):
            self._pending_ns.clear()
            log, self._log = self._log, None
            if log is not None:
                with suppress(OSError):
                    log.close()

    def fill(self, *, full: bool) -> None:
        """Fill the disk, or make room again."""
        filler = self.folder / "filler"
        filler.unlink(missing_ok=True)
        with suppress(OSError), filler.open("wb", buffering=0) as file:
            while full and file.write(bytes(4096)):
                pass


class _Soaked:
    """The nodes of one agent, as one."""

    def __init__(self, node: Node, config: SoakedConfig, report: Reporter) -> None:
        self._node, self._config, self._report = node, config, report
        self._streams = {name: Stream(name, report) for name in config.streams}
        self._recorder: Recorder | None = None
        self._viewing: list[Subscription] = []
        self._visits: list[Subscription] = []
        self._state = node.create_publisher(TEXT, f"/global/{config.agent}/{STATE}", LATCHED)
        self._counter = node.create_publisher(TEXT, f"/global/{config.agent}/count", NUMBERED)
        if config.disk:
            self._recorder = Recorder(Path(config.disk), self._streams["recorded"])
        for other in config.others:
            self._hear(other, "count", NUMBERED)
        self._come()

    def _hear(self, other: str, what: str, qos: QoSProfile) -> Subscription:
        topic, stream, recorder = (
            f"/global/{other}/{what}",
            self._streams[f"{what} of {other}"],
            self._recorder,
        )

        def hear(cdr: bytes) -> None:
            number, sent_ns = map(int, deserialize(cdr, message_type(TEXT)).data.split())
            stream.note(number, sent_ns)
            if recorder is not None:
                recorder.write(topic, cdr, sent_ns)

        return self._node.create_subscription(TEXT, topic, hear, qos, raw=True)

    def _come(self) -> None:
        """Look at the cameras, unless that is done, and hear the others' states as somebody who comes late."""
        while self._visits:
            self._visits.pop().close()
        self._visits = [self._hear(other, STATE, LATCHED) for other in self._config.others]
        for other in () if self._viewing else self._config.views:
            topic = f"/local/{other}/camera_front/color/image_raw"
            see = self._seeing(self._streams[f"pictures of {other}"])
            seen = self._node.create_subscription(IMAGE, topic, see, SENSOR_DATA, transport="shm")
            self._viewing.append(seen)

    def _seeing(self, stream: Stream) -> Callable[[Any], None]:
        def see(image: Any) -> None:
            number = int(image.header.frame_id.rpartition("_")[2])
            stream.damaged += read_number_flat(image.data, image.width, 3) != number
            stream.note(number, self._ns(number))

        return see

    def _ns(self, number: int) -> int:
        return self._config.epoch_ns + number * 10**9 // RATE_HZ

    def _now(self) -> int:
        return (time.monotonic_ns() - self._config.epoch_ns) * RATE_HZ // 10**9

    def obey(self, order: Report) -> None:
        """Follow an order: ``leave`` cameras, ``come`` with a mark, ``fill`` or ``free`` the disk, ``tell``."""
        match order["do"]:
            case "leave":
                while self._viewing:
                    self._viewing.pop().close()
            case "come":
                self._publish(self._state, self._now())
                self._come()
                for stream in self._streams.values():
                    stream.mark(order["mark"], order["after_ns"])
            case "tell":
                counts = ("name", "received", "repeated", "disordered", "damaged")
                streams = [
                    {name: getattr(s, name) for name in counts} for s in self._streams.values()
                ]
                self._report({"is": "told", "streams": streams})
            case kind if self._recorder is not None:
                self._recorder.fill(full=kind == "fill")

    @staticmethod
    def _publish(publisher: Any, number: int) -> None:
        publisher.publish(message_type(TEXT)(data=f"{number} {time.monotonic_ns()}"))

    async def send(self) -> None:
        """Publish numbered messages and pictures, each at its time; what is long due is left out."""
        agent, rate = self._config.agent, {"fps": RATE_HZ, "gop": 2 * RATE_HZ}
        settings = H264Settings(
            width=WIDTH, height=HEIGHT, bitrate_bps=500_000, encoder="libx264", **rate
        )
        encoder = H264Encoder(settings)
        camera = self._node.create_publisher(FFMPEG_PACKET, stream_topic(agent), COMPRESSED_STREAM)
        number = self._now()
        while True:
            number = max(number + 1, self._now() - RATE_HZ)
            await asyncio.sleep((self._ns(number) - time.monotonic_ns()) / 1e9)
            self._publish(self._counter, number)
            if number % (2 * RATE_HZ) == 0:
                self._publish(self._state, number)
            for message in _shot(encoder, settings, number) if self._config.shoots else ():
                camera.publish(message)


def _shot(encoder: H264Encoder, settings: H264Settings, number: int) -> list[Any]:
    """Return the messages of a picture that shows a number, and names it in its frame; by the agent's clock."""
    picture = np.full((HEIGHT, WIDTH, 3), number % 200, np.uint8)
    stamp_number(picture, number)
    stamp = stamp_from_ns(time.time_ns())
    header = message_type("std_msgs/msg/Header")(stamp=stamp, frame_id=f"camera_{number}")
    fields = [asdict(ffmpeg_packet_fields(packet, settings)) for packet in encoder.encode(picture)]
    data = [{"data": np.frombuffer(packet["data"], np.uint8)} for packet in fields]
    return [
        message_type(FFMPEG_PACKET)(header=header, **{**f, **d})
        for f, d in zip(fields, data, strict=True)
    ]


async def serve(config: SoakedConfig, report: Reporter, orders: Orders) -> None:
    """Publish, consume and obey until cancelled."""
    async with Node("soaked", **config.address.options()) as node:
        soaked = _Soaked(node, config, report)
        async with beside(soaked.send()):
            report({"is": "ready"})
            while True:
                soaked.obey(await orders.get())


if __name__ == "__main__":
    run_component(SoakedConfig, serve)
