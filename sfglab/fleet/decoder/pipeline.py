"""One stream decoded once: from the remote topic to everybody on this device who wants it.

The coroutine of a pipeline process: it decodes each message once and publishes the picture locally, by shared
memory and DDS as far as each is wanted; or it relays messages unchanged (camera info).
"""

from __future__ import annotations

import asyncio
import functools
import struct
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.errors import InvalidMessageError
from sfglab.codecs import CodecError, image_decoder
from sfglab.component import beside
from sfglab.fleet.decoder.splicer import Source, Splicer
from sfglab.fleet.decoder.streams import RELAY, Route
from sfglab.fleet.gop_config import FLAG_DISCARD, FLAG_KEY, REPLAY_QOS
from sfglab.messages import default_message, serialize
from sfglab.qos import COMPRESSED_STREAM, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from sfglab.bus import Node, Publisher, Subscription


def image_prefix(header: Any, pixels: NDArray[np.generic], encoding: str) -> bytes:
    """Return the CDR of an Image up to its first pixel, with a ``std_msgs/msg/Header``.

    Pixels have the shape (H, W) or (H, W, channels), C order; the encoding is such as ``bgr8`` or ``16UC1``.
    """
    prefix = _prefix(header.frame_id, encoding, pixels.shape[:2], pixels.strides[0], pixels.nbytes)
    # From picture to picture only the stamp changes, which stands behind the 4 bytes of the CDR header; to
    # serialise all of it anew takes ten times as long as to write it into its place.
    stamp = struct.pack("<iI", header.stamp.sec, header.stamp.nanosec)
    return prefix[:4] + stamp + prefix[4 + len(stamp) :]


@functools.lru_cache(maxsize=64)
def _prefix(
    frame_id: str, encoding: str, shape: tuple[int, ...], step: int, size_bytes: int
) -> bytes:
    image = default_message("sensor_msgs/msg/Image")
    image.header.frame_id = frame_id
    image.height, image.width = shape
    image.encoding = encoding
    image.is_bigendian = 0
    image.step = step
    # An empty sequence ends in its length, a 4-byte aligned uint32: put the real one there.
    return serialize(image)[:-4] + struct.pack("<I", size_bytes)


def write_image(buffer: Any, prefix: bytes, pixels: NDArray[np.generic]) -> None:
    """Write an Image into a buffer of exactly ``len(prefix) + pixels.nbytes`` bytes."""
    view = np.frombuffer(buffer, dtype=np.uint8)
    view[: len(prefix)] = np.frombuffer(prefix, dtype=np.uint8)
    view[len(prefix) : len(prefix) + pixels.nbytes] = pixels.reshape(-1).view(np.uint8)


def image_bytes(prefix: bytes, pixels: NDArray[np.generic]) -> bytes:
    """Return a whole Image, padded to four bytes as the middleware needs it."""
    body = prefix + pixels.tobytes()
    return body + bytes(-len(body) % 4)


LOCAL_QOS = QoSProfile(depth=5)  #: Reliable on the device, so that every subscription matches.

PATIENCE_S = 3.0  #: How long a replay may take to connect; a key frame will have come by then.


@dataclass(slots=True, kw_only=True)
class Statistics:
    """Counts of a pipeline since it was opened."""

    received: int = 0  #: Messages from the remote stream.
    replayed: int = 0  #: Messages from its replay.
    published: int = 0  #: Images handed to local subscribers.
    newest: int = -1  #: The latest one's number; -1: none, or they have no numbers.
    broken: int = 0  #: Messages that could not be decoded.
    last_error: str = ""  #: The latest decoding error; empty without one.


class Outputs:
    """The local publishers of one topic of a ROS type: one for each transport that somebody wants."""

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


async def run_pipeline(
    route: Route, transports: Iterable[str], *, remote: Node, outputs: Outputs, counts: Statistics
) -> None:
    """Decode or relay one stream from the remote node until cancelled, updating the counts.

    A message that cannot be decoded is counted and skipped: the next key frame heals the stream.

    Raises:
        CodecError: There is no decoder for this type and codec.
    """
    if route.codec == RELAY:
        await _relay(route, transports, remote, outputs, counts)
    else:
        await _decode(route, transports, remote, outputs, counts)


async def _relay(
    route: Route, transports: Iterable[str], remote: Node, outputs: Outputs, counts: Statistics
) -> None:
    with closing(
        remote.create_subscription(
            route.source_type, route.source_topic, qos=COMPRESSED_STREAM, raw=True
        )
    ) as subscription:
        outputs.serve(transports)
        async for cdr in subscription:
            counts.received += 1
            outputs.publish_raw(cdr)
            counts.published += 1


async def _decode(
    route: Route, transports: Iterable[str], remote: Node, outputs: Outputs, counts: Statistics
) -> None:
    with ExitStack() as stack:

        def subscribe(topic: str, qos: QoSProfile) -> Subscription:
            subscription = remote.create_subscription(route.source_type, topic, qos=qos)
            stack.callback(subscription.close)
            return subscription

        # What is far away first, the replay before all: routers connect one topic after the other.
        replay = subscribe(route.replay_topic, REPLAY_QOS) if route.replay_topic else None
        live = subscribe(route.source_topic, COMPRESSED_STREAM)
        outputs.serve(transports)
        decoding = _Decoding(route, outputs, counts)
        if replay is not None:
            await decoding.join(live, replay)
            replay.close()
        await decoding.follow(live)


class _Decoding:
    """One stream's packets on their way through the splicer and the decoder to the outputs."""

    def __init__(self, route: Route, outputs: Outputs, counts: Statistics) -> None:
        self._decoder = image_decoder(route.source_type, route.codec, most_pixels=route.most_pixels)
        self._numbered = bool(route.replay_topic)
        self._splicer: Splicer[Any] = Splicer(replay=self._numbered, after=route.after)
        self._outputs = outputs
        self._counts = counts
        self._arrived = asyncio.Event()

    async def join(self, live: Subscription, replay: Subscription) -> None:
        """Decode what comes from both until the live stream alone is enough."""
        sources = {Source.LIVE: live, Source.REPLAY: replay}
        async with beside(*(self._pump(s, source) for source, s in sources.items())) as pumps:
            try:
                async with asyncio.timeout(PATIENCE_S):
                    while self._splicer.needs_replay:
                        await self._step_or_wait()
                        for pump in pumps:
                            if pump.done():
                                pump.result()
            except TimeoutError:
                self._splicer.give_up()

    async def follow(self, live: Subscription) -> None:
        """Decode what is left from joining, and then the live stream as it comes."""
        await self._drain()
        messages = aiter(live)
        while not self._splicer.done:
            self._take(await anext(messages), Source.LIVE)
            await self._drain()
        async for message in messages:
            self._counts.received += 1
            await self._decode(message, show=not (self._numbered and message.flags & FLAG_DISCARD))

    async def _pump(self, subscription: Subscription, source: Source) -> None:
        try:
            async for message in subscription:
                self._take(message, source)
                self._arrived.set()
        finally:
            self._arrived.set()

    def _take(self, message: Any, source: Source) -> None:
        if source is Source.LIVE:
            self._counts.received += 1
        else:
            self._counts.replayed += 1
        pts, flags = (message.pts, message.flags) if self._numbered else (0, FLAG_KEY)
        is_key, shown = bool(flags & FLAG_KEY), not flags & FLAG_DISCARD
        self._splicer.take(message, source, pts=pts, is_key=is_key, shown=shown)

    async def _step_or_wait(self) -> None:
        self._arrived.clear()
        if not await self._step():
            await self._arrived.wait()

    async def _drain(self) -> None:
        while await self._step():
            pass

    async def _step(self) -> bool:
        """Decode the next message; return False where there is none."""
        step = self._splicer.next()
        if step is None:
            return False
        await self._decode(step.packet, show=step.show)
        return True

    async def _decode(self, message: Any, *, show: bool) -> None:
        try:
            if show:
                self._show(message)
            else:
                self._decoder.skip(message)
        except (CodecError, InvalidMessageError) as error:  # or it is larger than what is handed on
            self._counts.broken += 1
            self._counts.last_error = str(error)
        # A burst of queued messages must not keep orders, and newer messages, from being heard.
        await asyncio.sleep(0)

    def _show(self, message: Any) -> None:
        for image in self._decoder.feed(message):
            self._outputs.publish_image(message.header, image.array, image.encoding)
            self._counts.published += 1
            self._counts.newest = message.pts if self._numbered else -1
