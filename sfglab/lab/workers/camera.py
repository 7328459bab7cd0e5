"""The edge agent's camera process: ``python -m sfglab.lab.workers.camera CONFIG``.

The process encodes each frame once and publishes it best effort (paper A, section 4.3 and Table 2). It
reports when it runs, and several times per second which frames it has sent.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable
from contextlib import AsyncExitStack, closing
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab import codecs
from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.codecs import TABLE_2
from sfglab.component import Orders, Report, Reporter, run_component
from sfglab.lab.sources import Frame, SourceError, open_source
from sfglab.messages import message_type
from sfglab.qos import COMPRESSED_STREAM
from sfglab.spatial.poses import header_msg

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_FRAME = "camera_front"  #: TF frame of the camera.
_REPORT_S = 0.2  #: Time between two reports, s.
_Sent = tuple[int, int, int]  #: Number, capture stamp (ns) and compressed size of a frame.


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig:
    """Configuration of a camera process."""

    #: Destinations of the messages, each with a bus address and the name of the compressed topic there.
    places: tuple[tuple[BusAddress, str], ...]
    codec: str = "h264"  #: Codec: ``h264`` for colour or ``rvl`` for depth.
    source: str = "photos"  #: Source of frames, in the form of `open_source`.
    seed: int = 0  #: Seed of the source.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.


_Encode = Callable[[Frame], "list[DataclassInstance]"]


def _open_encoder(config: CameraConfig) -> tuple[str, str, _Encode]:
    """Return the encoder's name, the type of its messages, and a function from a frame to their fields."""
    if config.codec == "h264":
        settings = replace(TABLE_2, encoder=config.encoder)
        encoder = codecs.H264Encoder(settings)

        def encode(frame: Frame) -> list[DataclassInstance]:
            packets = encoder.encode(frame.bgr)
            return [codecs.ffmpeg_packet_fields(packet, settings) for packet in packets]

        return encoder.encoder_name, codecs.FFMPEG_PACKET, encode

    def encode_depth(frame: Frame) -> list[DataclassInstance]:
        if frame.depth_mm is None:
            raise SourceError(
                f"codec {config.codec!r}: the source has no depth; allowed: a source with depth, as stereo, or h264"
            )
        return [codecs.compressed_depth_fields(frame.depth_mm, codec=config.codec)]

    return config.codec, codecs.COMPRESSED_IMAGE, encode_depth


async def run_camera(config: CameraConfig, say: Callable[[str], None] = lambda _: None) -> None:
    """Publish until cancelled, and print once per second what was sent."""
    _, topic = config.places[0]
    second: list[_Sent] = []

    def print_report(report: Report) -> None:
        if report["is"] == "running":
            if report["source"]:
                say(report["source"])
            say(f"{topic}: {report['encoder']}, {report['type']}; end it with Ctrl-C")
            return
        second.extend(report["frames"])
        if len(second) >= TABLE_2.fps:
            rate = sum(size for _, _, size in second) * 8 * TABLE_2.fps / len(second) / 1e6
            say(f"{topic}: {second[-1][0] + 1} frames, {rate:.2f} Mbit/s")
            second.clear()

    await serve(config, print_report, Orders())


async def serve(config: CameraConfig, report: Reporter, _: Orders) -> None:
    """Read, encode and publish frames indefinitely, each at its due time.

    The report ``running`` has the encoder, the type of messages, and the sentence about the source;
    the report ``sent``, several times per second, has the frames that were sent.
    """
    source = open_source(
        config.source, width=TABLE_2.width, height=TABLE_2.height, fps=TABLE_2.fps, seed=config.seed
    )
    unreported: list[_Sent] = []
    async with AsyncExitStack() as stack:
        stack.enter_context(closing(source))
        encoder, type_, encode = _open_encoder(config)
        publishers = []
        for address, topic in config.places:
            node = await stack.enter_async_context(Node("camera_front", **address.options()))
            publishers.append(node.create_publisher(type_, topic, COMPRESSED_STREAM))
        running = {"encoder": encoder, "type": type_, "source": source.said}
        report({"is": "running", **running})
        started_s = time.monotonic()
        try:
            for number in itertools.count():
                frame = source.frame()
                due_s = started_s + number / TABLE_2.fps
                await asyncio.sleep(max(0.0, due_s - time.monotonic()))
                stamp_ns = time.time_ns()
                for fields in encode(frame):
                    message = _message(type_, header_msg(_FRAME, stamp_ns), fields)
                    # The first destination changes with each frame.
                    first = number % len(publishers)
                    for publisher in publishers[first:] + publishers[:first]:
                        publisher.publish(message)
                    unreported.append((number, stamp_ns, len(message.data)))
                if len(unreported) >= TABLE_2.fps * _REPORT_S:
                    report({"is": "sent", "frames": unreported})
                    unreported = []
        finally:
            if unreported:
                report({"is": "sent", "frames": unreported})


def _message(type_: str, header: Any, fields: DataclassInstance) -> Any:
    values = asdict(fields)
    values["data"] = np.frombuffer(values["data"], np.uint8)
    return message_type(type_)(header=header, **values)


if __name__ == "__main__":
    run_component(CameraConfig, serve)
