"""Subscriber that reads every pixel: ``python -m sfglab.lab.workers.viewer CONFIG``.

The process represents any node that consumes a camera stream. The order ``look`` starts a subscription and names the
mode. Mode ``standard``
receives and decodes in this process. Mode ``proxy`` takes decoded images from shared memory, and mode ``dds`` over
DDS. Mode ``raw`` receives images that were never coded. Mode ``network`` receives and discards. With a path, an order
records the stream instead. A topic in the order replaces the mode's configured one. The viewer reads every pixel of
every image, and reports the capture stamp of each.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.codecs import CodecError, image_decoder
from sfglab.component import Orders, Report, Reporter, run_component
from sfglab.messages import ns_from_stamp
from sfglab.qos import COMPRESSED_STREAM, SENSOR_DATA

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable

    from numpy.typing import NDArray

    from sfglab.codecs.carriers import ImageDecoder

_AGES_KEPT = 300
IMAGE = "sensor_msgs/msg/Image"


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewerConfig:
    """Configuration of a viewer."""

    remote: BusAddress  #: Bus address of the remote streams.
    local: BusAddress  #: Bus address of the decoded topics.
    remote_topic: str  #: Name of the compressed topic.
    remote_type: str  #: ROS type of the compressed topic.
    codec: str  #: Codec hint.
    local_topic: str  #: Name of the decoded topic.
    #: Whether its nodes are in their domains all the time, as those of a display are, and its codec is
    #: loaded. Otherwise they join with each order to look.
    joined: bool = False


@dataclass(slots=True)
class Seen:
    """Results of a viewer since the last order to look."""

    frames: int = 0  #: Number of messages or images.
    broken: int = 0  #: Number of messages that could not be decoded.
    #: Capture stamp and time of arrival in this process (Unix time, ns) of each image.
    sightings: list[tuple[int, int]] = field(default_factory=list)

    def look(self, items: NDArray[Any], stamp_ns: int) -> None:
        """Count an image with its capture stamp, ns, and read all its pixels; its size is a multiple of 8 bytes."""
        self.sightings.append((stamp_ns, time.time_ns()))
        self.frames += 1
        np.bitwise_xor.reduce(items.view(np.uint64))

    def report(self) -> dict[str, Any]:
        """Return the counts as JSON values, with the ages of the latest images, ns."""
        ages_ns = [seen_ns - stamp_ns for stamp_ns, seen_ns in self.sightings[-_AGES_KEPT:]]
        return {"is": "seen", "ages_ns": ages_ns, **asdict(self)}


class _Viewer:
    """Viewer process, which takes orders, reads images and reports."""

    def __init__(self, config: ViewerConfig, report: Reporter) -> None:
        self._config, self._report = config, report
        self._looking: asyncio.Task[None] | None = None
        self._seen = Seen()
        self._ordered_ns = 0
        self._nodes: dict[str, Any] = {}

    async def run(self, orders: Orders) -> None:
        """Follow orders until cancelled."""
        async with contextlib.AsyncExitStack() as stack:
            for side in ("remote", "local") if self._config.joined else ():
                self._nodes[side] = await stack.enter_async_context(self._new_node("viewer", side))
                image_decoder(self._config.remote_type, self._config.codec)
            self._report({"is": "ready"})
            try:
                while True:
                    await self._obey(await orders.get())
            finally:
                await self._stop()

    async def _obey(self, order: Report) -> None:
        if order["do"] == "look":
            self._ordered_ns = time.time_ns()
            self._seen = Seen()
            self._looking = asyncio.create_task(self._look(order))
        else:
            await self._stop()
            self._report(self._seen.report())

    def _new_node(self, name: str, side: str) -> Any:
        return Node(name, **getattr(self._config, side).options())

    @contextlib.asynccontextmanager
    async def _node(self, name: str, side: str) -> AsyncIterator[Any]:
        if side in self._nodes:
            yield self._nodes[side]
        else:
            async with self._new_node(name, side) as node:
                yield node

    async def _stop(self) -> None:
        if self._looking is not None:
            self._looking.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._looking
            self._looking = None

    async def _look(self, order: Report) -> None:
        config, mode = self._config, order["mode"]
        side = "local" if mode in ("proxy", "dds") else "remote"
        usual = config.local_topic if side == "local" else config.remote_topic
        topic = order.get("topic") or usual
        try:
            async with self._node("recorder" if "path" in order else "viewer", side) as node:
                if "path" in order:
                    await self._record(node, topic, Path(order["path"]))
                else:
                    await self._receive(node, topic, mode)
        except Exception as error:  # noqa: BLE001  # the experiment must learn why a viewer failed
            self._report({"is": "failed", "why": f"{type(error).__name__}: {error}"})

    async def _receive(self, node: Node, topic: str, mode: str) -> None:
        """Receive from a subscription until cancelled."""
        type_ = self._config.remote_type
        qos = COMPRESSED_STREAM
        options: dict[str, Any] = {"threaded": True}
        see: Callable[[Any], None] = self._see_image
        if mode == "standard":
            see = partial(self._decode, image_decoder(type_, self._config.codec))
        elif mode == "network":
            see = self._discard
            options["raw"] = True
        else:
            type_ = IMAGE
            qos = SENSOR_DATA
            options["transport"] = "shm" if mode == "proxy" else "dds"
        with contextlib.closing(node.create_subscription(type_, topic, see, qos, **options)):
            await asyncio.Event().wait()

    def _decode(self, decoder: ImageDecoder, message: Any) -> None:
        try:
            images = decoder.feed(message)
        except CodecError:
            self._seen.broken += 1
            return
        for image in images:
            self._seen.look(image.array.reshape(-1), ns_from_stamp(message.header.stamp))
            self._saw_one()

    def _see_image(self, image: Any) -> None:
        self._seen.look(image.data, ns_from_stamp(image.header.stamp))
        self._saw_one()

    def _discard(self, _: bytes) -> None:
        self._seen.frames += 1
        self._saw_one()

    def _saw_one(self) -> None:
        if self._seen.frames == 1:
            sightings = self._seen.sightings
            seen_ns = sightings[0][1] if sightings else time.time_ns()
            self._report({"is": "first", "ordered_ns": self._ordered_ns, "seen_ns": seen_ns})

    async def _record(self, node: Node, topic: str, path: Path) -> None:
        """Write the stream's messages unchanged into a log of their own as they arrive."""
        from sfglab.record import LogWriter

        type_ = self._config.remote_type
        subscription = node.create_subscription(type_, topic, qos=COMPRESSED_STREAM, raw=True)
        with contextlib.closing(subscription), LogWriter(path) as log:
            while True:
                cdr, info = await subscription.take_with_info()
                log.write_raw(
                    topic,
                    type_,
                    cdr,
                    qos=COMPRESSED_STREAM,
                    log_time_ns=info.received_timestamp_ns,
                    publish_time_ns=info.source_timestamp_ns,
                )
                self._discard(cdr)


async def serve(config: ViewerConfig, report: Reporter, orders: Orders) -> None:
    """Run a viewer of images, which follows orders until cancelled."""
    await _Viewer(config, report).run(orders)


if __name__ == "__main__":
    run_component(ViewerConfig, serve)
