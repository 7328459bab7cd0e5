"""A subscriber that looks at every pixel: ``python -m sfglab.lab.workers.viewer CONFIG``.

Stands for any node that consumes a camera stream. It is started once and told when to look and how:
``standard`` (receive and decode for itself), ``proxy`` (take decoded pictures from shared memory) or
``network`` (receive and throw away); or, with a path, to record the stream. Reads every pixel of every
frame and the number drawn into it, so that its report proves what it saw. Orders and reports are JSON lines.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from collections import deque
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs import CodecError, image_decoder
from sfglab.lab.framenumber import read_number_flat
from sfglab.messages import ns_from_stamp
from sfglab.pipes import claim_standard_output, run, standard_input_lines
from sfglab.qos import COMPRESSED_STREAM, SENSOR_DATA

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from numpy.typing import NDArray

__all__ = ["MODES", "Seen", "ViewerConfig", "main"]

MODES = ("standard", "proxy", "network")
PAIRS_KEPT = 30
IMAGE = "sensor_msgs/msg/Image"


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewerConfig:
    """What a viewer is told when it starts.

    Attributes:
        remote: Keyword arguments of the node on the remote streams' domain.
        local: Keyword arguments of the node on the local domain.
        remote_topic: The compressed topic.
        remote_type: Its type.
        codec: Codec hint.
        local_topic: The decoded topic.
    """

    remote: dict[str, Any]
    local: dict[str, Any]
    remote_topic: str
    remote_type: str
    codec: str
    local_topic: str

    def to_json(self) -> str:
        """Return the configuration as the process's argument."""
        return json.dumps(asdict(self))


@dataclass(slots=True)
class Seen:
    """What a viewer has seen since it was told to look.

    Attributes:
        frames: Messages or pictures.
        unreadable: Pictures whose number could not be read.
        missed: Numbers skipped between two pictures.
        disordered: Pictures that were not newer than the one before.
        broken: Messages that could not be decoded.
        checksum: Exclusive or of all pixels, as 64-bit words.
        pairs: Number and capture stamp (ns) of the latest pictures.
        ages_ns: From capture stamp to the picture in hand, of the latest pictures.
    """

    frames: int = 0
    unreadable: int = 0
    missed: int = 0
    disordered: int = 0
    broken: int = 0
    checksum: int = 0
    pairs: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=PAIRS_KEPT))
    ages_ns: deque[int] = field(default_factory=lambda: deque(maxlen=10 * PAIRS_KEPT))
    _last: int | None = None

    def look(self, items: NDArray[Any], width: int, channels: int, stamp_ns: int) -> None:
        """Read every pixel and the number of one picture.

        Args:
            items: The pixels' items in C order, shape (H * W * channels,), a multiple of eight bytes.
            width: Pixels in a row.
            channels: Items in a pixel.
            stamp_ns: Its capture stamp, nanoseconds.
        """
        self.frames += 1
        self.ages_ns.append(time.time_ns() - stamp_ns)
        self.checksum ^= int(np.bitwise_xor.reduce(items.view(np.uint64)))
        number = read_number_flat(items, width, channels)
        if number is None:
            self.unreadable += 1
            return
        if self._last is not None:
            self.missed += max(0, number - self._last - 1)
            self.disordered += number <= self._last
        self._last = number
        self.pairs.append((number, stamp_ns))

    def report(self) -> dict[str, Any]:
        """Return the counts as JSON values."""
        return {
            "is": "seen",
            "frames": self.frames,
            "unreadable": self.unreadable,
            "missed": self.missed,
            "disordered": self.disordered,
            "broken": self.broken,
            "checksum": self.checksum,
            "pairs": list(self.pairs),
            "ages_ns": list(self.ages_ns),
        }


class Viewer:
    """One viewer process: takes orders, looks, reports.

    Args:
        config: Where the streams are.
        report: Takes a report.
    """

    def __init__(self, config: ViewerConfig, report: Callable[[dict[str, Any]], None]) -> None:
        self._config = config
        self._report = report
        self._looking: asyncio.Task[None] | None = None
        self._seen = Seen()

    async def run(self, orders: AsyncIterator[bytes]) -> None:
        """Obey orders until they end."""
        self._report({"is": "ready"})
        try:
            async for line in orders:
                order = json.loads(line)
                if order["do"] == "look":
                    self._seen = Seen()
                    self._looking = asyncio.create_task(self._look(order["mode"], order.get("path")))
                else:
                    await self._stop()
                    self._report(self._seen.report())
        finally:
            await self._stop()

    async def _stop(self) -> None:
        if self._looking is not None:
            self._looking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._looking
            self._looking = None

    async def _look(self, mode: str, path: str | None) -> None:
        ways = {"standard": self._decode, "proxy": self._share, "network": self._discard}
        try:
            await (self._record(Path(path)) if path else ways[mode]())
        except Exception as error:  # noqa: BLE001  # the experiment must hear why a viewer fell out
            self._report({"is": "failed", "why": f"{type(error).__name__}: {error}"})

    def _saw_one(self) -> None:
        if self._seen.frames == 1:
            self._report({"is": "first"})

    async def _decode(self) -> None:
        decoder = image_decoder(self._config.remote_type, self._config.codec)

        def see(message: Any) -> None:
            try:
                images = decoder.feed(message)
            except CodecError:
                self._seen.broken += 1
                return
            for image in images:
                pixels = image.array
                channels = pixels.shape[2] if pixels.ndim == 3 else 1
                self._seen.look(
                    pixels.reshape(-1), pixels.shape[1], channels, ns_from_stamp(message.header.stamp)
                )
                self._saw_one()

        await self._subscribe(see)

    async def _discard(self) -> None:
        def see(_: bytes) -> None:
            self._seen.frames += 1
            self._saw_one()

        await self._subscribe(see, raw=True)

    async def _subscribe(self, see: Callable[[Any], None], *, raw: bool = False) -> None:
        """Receive the remote stream until cancelled."""
        from sfglab.bus import Node

        async with Node("viewer", **self._config.remote) as node:
            topic, type_ = self._config.remote_topic, self._config.remote_type
            node.create_subscription(type_, topic, see, qos=COMPRESSED_STREAM, raw=raw)
            await asyncio.Event().wait()

    async def _share(self) -> None:
        """Take decoded pictures from shared memory until cancelled."""
        from sfglab.bus import Node

        def see(image: Any) -> None:
            items, channels = (image.data, 3) if image.encoding == "bgr8" else (image.data.view(np.uint16), 1)
            self._seen.look(items, image.width, channels, ns_from_stamp(image.header.stamp))
            self._saw_one()

        async with Node("viewer", **self._config.local) as node:
            topic = self._config.local_topic
            node.create_subscription(IMAGE, topic, see, qos=SENSOR_DATA, transport="shm")
            await asyncio.Event().wait()

    async def _record(self, path: Path) -> None:
        """Write the stream's messages into a log of its own as they come in, unconverted."""
        from sfglab.bus import Node
        from sfglab.record import LogWriter

        topic, type_ = self._config.remote_topic, self._config.remote_type
        async with Node("recorder", **self._config.remote) as node:
            subscription = node.create_subscription(type_, topic, qos=COMPRESSED_STREAM, raw=True)
            with LogWriter(path) as log:
                while True:
                    cdr, info = await subscription.take_with_info()
                    log.write_raw(
                        topic,
                        type_,
                        cdr,
                        log_time_ns=info.received_timestamp_ns,
                        publish_time_ns=info.source_timestamp_ns,
                        qos=COMPRESSED_STREAM,
                    )
                    self._seen.frames += 1
                    self._saw_one()


def main() -> None:
    """Run the viewer with the configuration given as its one argument."""
    config = ViewerConfig(**json.loads(sys.argv[1]))
    write = claim_standard_output()
    viewer = Viewer(config, lambda report: write(json.dumps(report).encode() + b"\n"))
    run(viewer.run(standard_input_lines()))


if __name__ == "__main__":
    main()
