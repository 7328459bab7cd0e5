"""One stream decoded once: from the remote topic to everybody on this device who wants it.

The coroutine that a pipeline process runs. It subscribes to the compressed remote topic, decodes each
message once and publishes the picture on the local topic, by shared memory and by DDS as far as each is
wanted; or relays messages unchanged (camera info). Knows nodes and codecs; refuses to know processes and
demand.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.codecs import CodecError, image_decoder
from sfglab.fleet.decoder.images import image_bytes, image_prefix, write_image
from sfglab.fleet.decoder.protocol import RELAY, Open, Statistics
from sfglab.qos import COMPRESSED_STREAM, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.bus.api import Node, Publisher

__all__ = ["Counters", "Outputs", "run_pipeline"]

LOCAL_QOS = QoSProfile(depth=5)
"""Reliable on the device, so that every subscription matches: no less may be offered than is asked for."""

IMAGE_TYPE = "sensor_msgs/msg/Image"


@dataclass(slots=True)
class Counters:
    """What a pipeline has done since it was opened."""

    received: int = 0
    published: int = 0
    broken: int = 0
    last_error: str = ""

    def snapshot(self) -> Statistics:
        """Return the counts as they are now."""
        return Statistics(
            received=self.received, published=self.published, broken=self.broken, last_error=self.last_error
        )


class Outputs:
    """The local publishers of one topic: one for each transport that somebody wants.

    Args:
        local: The node on the local domain.
        type_: ROS type of the local topic.
        topic: The local topic.
    """

    def __init__(self, local: Node, type_: str, topic: str) -> None:
        self._local = local
        self._type = type_
        self._topic = topic
        self._publishers: dict[str, Publisher] = {}

    def serve(self, transports: Iterable[str]) -> None:
        """Open and close publishers so that exactly these transports are served."""
        wanted = set(transports)
        for gone in set(self._publishers) - wanted:
            self._publishers.pop(gone).close()
        for new in sorted(wanted - set(self._publishers)):
            self._publishers[new] = self._local.create_publisher(
                self._type,
                self._topic,
                LOCAL_QOS,
                transport=new,  # type: ignore[arg-type]  # the protocol carries text
            )

    def publish_image(self, header: Any, pixels: Any, encoding: str) -> None:
        """Publish one picture by every transport that is served."""
        prefix = image_prefix(header, pixels, encoding)
        for transport, publisher in self._publishers.items():
            if transport == "shm":
                with publisher.loan(len(prefix) + pixels.nbytes) as buffer:  # type: ignore[attr-defined]  # shm only
                    write_image(buffer, prefix, pixels)
            else:
                publisher.publish_raw(image_bytes(prefix, pixels))

    def publish_raw(self, cdr: bytes) -> None:
        """Publish one message unchanged by every transport that is served."""
        for publisher in self._publishers.values():
            publisher.publish_raw(cdr)

    def close(self) -> None:
        """End all publishers; again is harmless."""
        self.serve(())


async def run_pipeline(order: Open, *, remote: Node, outputs: Outputs, counters: Counters) -> None:
    """Decode or relay one stream until cancelled.

    A message that cannot be decoded is counted and skipped: the next key frame heals the stream. A stream
    that pauses simply has no messages meanwhile.

    Args:
        order: Which stream.
        remote: The node on the domain where the remote topic is.
        outputs: Where pictures go.
        counters: Counts, updated in place.

    Raises:
        CodecError: There is no decoder for this type and codec.
    """
    if order.codec == RELAY:
        await _relay(order, remote, outputs, counters)
    else:
        await _decode(order, remote, outputs, counters)


async def _relay(order: Open, remote: Node, outputs: Outputs, counters: Counters) -> None:
    subscription = remote.create_subscription(
        order.source_type, order.source_topic, qos=COMPRESSED_STREAM, raw=True
    )
    try:
        async for cdr in subscription:
            counters.received += 1
            outputs.publish_raw(cdr)
            counters.published += 1
    finally:
        subscription.close()


async def _decode(order: Open, remote: Node, outputs: Outputs, counters: Counters) -> None:
    decoder = image_decoder(order.source_type, order.codec)
    subscription = remote.create_subscription(order.source_type, order.source_topic, qos=COMPRESSED_STREAM)
    try:
        async for message in subscription:
            counters.received += 1
            try:
                images = decoder.feed(message)
            except CodecError as error:
                counters.broken += 1
                counters.last_error = str(error)
                continue
            for image in images:
                outputs.publish_image(message.header, image.array, image.encoding)
                counters.published += 1
            # A burst of queued messages must not keep orders from being heard.
            await asyncio.sleep(0)
    finally:
        subscription.close()
