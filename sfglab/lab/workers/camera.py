"""The edge agent's camera process: ``python -m sfglab.lab.workers.camera CONFIG``.

The process encodes each frame once and publishes it best effort (paper A, section 4.3 and Table 2). It
reports when it runs, and several times per second which frames it has sent.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from contextlib import AsyncExitStack, asynccontextmanager, closing
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sfglab import codecs
from sfglab.bus import Node, Publisher
from sfglab.bus.address import BusAddress
from sfglab.component import Orders, Reporter, run_component
from sfglab.lab.sources import Frame, SourceError, open_source
from sfglab.messages import message_type
from sfglab.qos import COMPRESSED_STREAM
from sfglab.spatial.poses import header_msg

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Coroutine

    from _typeshed import DataclassInstance

_REPORT_S = 0.2  #: Time between two reports, s.
_Sent = tuple[int, int, int]  #: Number, capture stamp (ns) and compressed size of a frame.


class _Shooting(NamedTuple):
    encoder: _ColourEncoder | _DepthEncoder
    shoot: Coroutine[Any, Any, None]
    said: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig:
    """Configuration of a camera process."""

    #: Destinations of the messages, each with a bus address and the name of the compressed topic there.
    places: tuple[tuple[BusAddress, str], ...]
    codec: str = "h264"  #: Codec: ``h264`` for colour or ``rvl`` for depth.
    source: str = "photos"  #: Source of frames, in the form of `open_source`.
    seed: int = 0  #: Seed of the source.
    width: int = 640  #: Width of the frames, pixels.
    height: int = 360  #: Height of the frames, pixels.
    fps: float = 30.0  #: Frame rate, frames per second.
    bitrate_bps: int = 4_000_000  #: Bit rate of H.264, bits per second.
    gop: int = 30  #: Number of frames from one key frame to the next.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.
    frame_id: str = "camera_front"  #: TF frame of the camera.


class _ColourEncoder:
    """Encoder of frames to FFMPEGPacket messages."""

    type = codecs.FFMPEG_PACKET

    def __init__(self, config: CameraConfig) -> None:
        self._settings = codecs.H264Settings(
            width=config.width,
            height=config.height,
            fps=config.fps,
            bitrate_bps=config.bitrate_bps,
            gop=config.gop,
            encoder=config.encoder,
        )
        self._encoder = codecs.H264Encoder(self._settings)
        self.name = self._encoder.encoder_name

    def messages(self, frame: Frame, header: Any) -> list[Any]:
        packets = self._encoder.encode(frame.bgr)
        fields = (codecs.ffmpeg_packet_fields(packet, self._settings) for packet in packets)
        return [_message(codecs.FFMPEG_PACKET, header, f) for f in fields]


class _DepthEncoder:
    """Encoder of depth frames to CompressedImage messages."""

    type = codecs.COMPRESSED_IMAGE

    def __init__(self, config: CameraConfig) -> None:
        self.name = config.codec

    def messages(self, frame: Frame, header: Any) -> list[Any]:
        if frame.depth_mm is None:
            raise SourceError(
                f"codec {self.name!r} codes depth, and the source has none: 'stereo' has"
            )
        fields = codecs.compressed_depth_fields(frame.depth_mm, codec=self.name)
        return [_message(codecs.COMPRESSED_IMAGE, header, fields)]


def _message(type_: str, header: Any, fields: DataclassInstance) -> Any:
    values = asdict(fields)
    return message_type(type_)(
        header=header, **{**values, "data": np.frombuffer(values["data"], np.uint8)}
    )


@asynccontextmanager
async def _camera(
    config: CameraConfig, sent: Callable[[list[_Sent]], None]
) -> AsyncIterator[_Shooting]:
    """Open source, encoder and publishers; the caller awaits the task that publishes."""
    source = open_source(
        config.source, width=config.width, height=config.height, fps=config.fps, seed=config.seed
    )
    with closing(source):
        encoder = _ColourEncoder(config) if config.codec == "h264" else _DepthEncoder(config)
        async with AsyncExitStack() as stack:
            publishers = []
            for address, topic in config.places:
                node = await stack.enter_async_context(Node("camera_front", **address.options()))
                publishers.append(node.create_publisher(encoder.type, topic, COMPRESSED_STREAM))
            yield _Shooting(encoder, _shoot(config, source, encoder, publishers, sent), source.said)


async def serve(config: CameraConfig, report: Reporter, _: Orders) -> None:
    """Publish for an experiment until told to end."""
    async with _camera(config, lambda frames: report({"is": "sent", "frames": frames})) as camera:
        report({"is": "running", "encoder": camera.encoder.name, "type": camera.encoder.type})
        await camera.shoot


async def run_camera(config: CameraConfig, say: Callable[[str], None] = lambda _: None) -> None:
    """Publish until cancelled, and print once per second what was sent."""
    _, topic = config.places[0]
    second: list[_Sent] = []

    def count(frames: list[_Sent]) -> None:
        second.extend(frames)
        if len(second) >= config.fps:
            rate = sum(size for _, _, size in second) * 8 * config.fps / len(second) / 1e6
            say(f"{topic}: {second[-1][0] + 1} frames, {rate:.2f} Mbit/s")
            second.clear()

    async with _camera(config, count) as camera:
        if camera.said:
            say(camera.said)
        say(f"{topic}: {camera.encoder.name}, {camera.encoder.type}; end it with Ctrl-C")
        await camera.shoot


async def _shoot(
    config: CameraConfig,
    source: Any,
    encoder: _ColourEncoder | _DepthEncoder,
    publishers: list[Publisher],
    sent: Callable[[list[_Sent]], None],
) -> None:
    """Read, encode and publish frames indefinitely, each at its due time."""
    started = time.monotonic()
    unreported: list[_Sent] = []
    try:
        for number in itertools.count():
            frame = source.frame()
            due = started + number / config.fps
            await asyncio.sleep(max(0.0, due - time.monotonic()))
            stamp_ns = time.time_ns()
            for message in encoder.messages(frame, header_msg(config.frame_id, stamp_ns)):
                first = number % len(publishers)  # the first destination changes with each frame
                for publisher in publishers[first:] + publishers[:first]:
                    publisher.publish(message)
                unreported.append((number, stamp_ns, len(message.data)))
            if len(unreported) >= config.fps * _REPORT_S:
                sent(unreported)
                unreported = []
    finally:
        if unreported:
            sent(unreported)


if __name__ == "__main__":
    run_component(CameraConfig, serve)
