"""One stream decoded once: from the remote topic to everybody on this device who wants it.

The coroutine that a pipeline process runs. It subscribes to the compressed remote topic, decodes each
message once and publishes the picture on the local topic, by shared memory and by DDS as far as each is
wanted; or relays messages unchanged (camera info). Knows nodes and codecs; refuses to know processes and
demand.
"""

from __future__ import annotations

import asyncio
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.codecs import CodecError, image_decoder
from sfglab.fleet.decoder.images import image_bytes, image_prefix, write_image
from sfglab.fleet.decoder.joiner import Joiner, Source
from sfglab.fleet.decoder.protocol import RELAY, Open, Statistics
from sfglab.fleet.keeper import FLAG_DISCARD, FLAG_KEY, REPLAY_QOS
from sfglab.qos import COMPRESSED_STREAM, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.bus import Node, Publisher, Subscription


LOCAL_QOS = QoSProfile(depth=5)
"""Reliable on the device, so that every subscription matches: no less may be offered than is asked for."""

IMAGE_TYPE = "sensor_msgs/msg/Image"

PATIENCE_S = 3.0
"""How long a replay may take to connect with the live stream; a key frame will have come by then."""


@dataclass(slots=True)
class Counters:
    """What a pipeline has done since it was opened."""

    received: int = 0
    replayed: int = 0
    published: int = 0
    broken: int = 0
    last_error: str = ""

    def snapshot(self) -> Statistics:
        """Return the counts as they are now."""
        return Statistics(
            received=self.received,
            replayed=self.replayed,
            published=self.published,
            broken=self.broken,
            last_error=self.last_error,
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
                with publisher.loan(len(prefix) + pixels.nbytes) as buffer:
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
        order: Which stream, and by which transports it is wanted.
        remote: The node on the domain where the remote topic is.
        outputs: Where pictures go; served from here on.
        counters: Counts, updated in place.

    Raises:
        CodecError: There is no decoder for this type and codec.
    """
    if order.codec == RELAY:
        await _relay(order, remote, outputs, counters)
    else:
        await _decode(order, remote, outputs, counters)


async def _relay(order: Open, remote: Node, outputs: Outputs, counters: Counters) -> None:
    with closing(
        remote.create_subscription(order.source_type, order.source_topic, qos=COMPRESSED_STREAM, raw=True)
    ) as subscription:
        outputs.serve(order.transports)
        async for cdr in subscription:
            counters.received += 1
            outputs.publish_raw(cdr)
            counters.published += 1


async def _decode(order: Open, remote: Node, outputs: Outputs, counters: Counters) -> None:
    with ExitStack() as stack:

        def subscribe(topic: str, qos: QoSProfile) -> Subscription:
            subscription = remote.create_subscription(order.source_type, topic, qos=qos)
            stack.callback(subscription.close)
            return subscription

        # What is far away first, the replay before all: routers connect one topic after the other.
        replay = subscribe(order.replay_topic, REPLAY_QOS) if order.replay_topic else None
        live = subscribe(order.source_topic, COMPRESSED_STREAM)
        outputs.serve(order.transports)
        decoding = _Decoding(order, outputs, counters)
        if replay is not None:
            await decoding.join(live, replay)
            replay.close()
        await decoding.follow(live)


class _Decoding:
    """One stream's packets on their way through the joiner and the decoder to the outputs."""

    def __init__(self, order: Open, outputs: Outputs, counters: Counters) -> None:
        self._decoder = image_decoder(order.source_type, order.codec)
        self._numbered = bool(order.replay_topic)
        self._joiner: Joiner[Any] = Joiner(replay=self._numbered)
        self._outputs = outputs
        self._counters = counters
        self._arrived = asyncio.Event()

    async def join(self, live: Subscription, replay: Subscription) -> None:
        """Decode what comes from both until the live stream alone is enough."""
        sources = {Source.LIVE: live, Source.REPLAY: replay}
        pumps = [asyncio.create_task(self._pump(s, source)) for source, s in sources.items()]
        try:
            async with asyncio.timeout(PATIENCE_S):
                while self._joiner.needs_replay:
                    await self._step_or_wait()
                    for pump in pumps:
                        if pump.done():
                            pump.result()
        except TimeoutError:
            self._joiner.give_up()
        finally:
            for pump in pumps:
                pump.cancel()
            await asyncio.gather(*pumps, return_exceptions=True)

    async def follow(self, live: Subscription) -> None:
        """Decode what is left from joining, and then the live stream as it comes."""
        await self._drain()
        async for message in live:
            self._take(message, Source.LIVE)
            await self._drain()

    async def _pump(self, subscription: Subscription, source: Source) -> None:
        try:
            async for message in subscription:
                self._take(message, source)
                self._arrived.set()
        finally:
            self._arrived.set()

    def _take(self, message: Any, source: Source) -> None:
        if source is Source.LIVE:
            self._counters.received += 1
        else:
            self._counters.replayed += 1
        pts, flags = (message.pts, message.flags) if self._numbered else (0, FLAG_KEY)
        self._joiner.take(
            message, source, pts=pts, is_key=bool(flags & FLAG_KEY), shown=not flags & FLAG_DISCARD
        )

    async def _step_or_wait(self) -> None:
        self._arrived.clear()
        if not await self._step():
            await self._arrived.wait()

    async def _drain(self) -> None:
        while await self._step():
            pass

    async def _step(self) -> bool:
        """Decode the next message; return False where there is none."""
        step = self._joiner.next()
        if step is None:
            return False
        try:
            if step.show:
                self._show(step.packet)
            else:
                self._decoder.skip(step.packet)
        except CodecError as error:
            self._counters.broken += 1
            self._counters.last_error = str(error)
        # A burst of queued messages must not keep orders, and newer messages, from being heard.
        await asyncio.sleep(0)
        return True

    def _show(self, message: Any) -> None:
        for image in self._decoder.feed(message):
            self._outputs.publish_image(message.header, image.array, image.encoding)
            self._counters.published += 1
