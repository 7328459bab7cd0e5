"""Decoding of one stream, from the remote topic to all subscribers on this device.

The coroutine of a pipeline process decodes each message once and publishes the result locally, over shared
memory and DDS as far as each is subscribed to. Messages of camera info it relays unchanged.
"""

from __future__ import annotations

import asyncio
import functools
import struct
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.errors import InvalidMessageError
from sfglab.codecs import CodecError, image_decoder
from sfglab.codecs.errors import MAX_PIXELS
from sfglab.component import beside
from sfglab.fleet.decoder.splicer import Source, Splicer
from sfglab.fleet.decoder.streams import IMAGE_TYPE, RELAY, Route
from sfglab.fleet.gop_config import FLAG_DISCARD, FLAG_KEY, REPLAY_QOS
from sfglab.messages import default_message, serialize
from sfglab.qos import COMPRESSED_STREAM, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from sfglab.bus import Node, Publisher, Subscription


def image_prefix(header: Any, pixels: NDArray[np.generic], encoding: str) -> bytes:
    """Return the CDR of an Image up to its first pixel, with a ``std_msgs/msg/Header``.

    Pixels have the shape (H, W) or (H, W, channels), C order; the encoding is such as ``bgr8`` or ``16UC1``.
    """
    prefix = _prefix(header.frame_id, encoding, pixels.shape[:2], pixels.strides[0], pixels.nbytes)
    # Between frames only the stamp changes, which follows the 4 bytes of the CDR header. Serialising all fields
    # takes ten times as long as replacing the stamp.
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
    # The CDR of an empty sequence ends in its length, a 4-byte aligned uint32. It is replaced by the real
    # length.
    return serialize(image)[:-4] + struct.pack("<I", size_bytes)


@dataclass(frozen=True, slots=True)
class StreamCodec:
    """Codec of the streams that are decoded to messages of one ROS type."""

    #: Function that returns a route's decoder: `feed(message)` yields decoded values, `skip(message)`
    #: decodes without them.
    decoder: Callable[[Route], Any]
    #: Function of a header and a decoded value that returns the message's CDR up to its last field, and
    #: that field's items, in an array of any shape.
    parts: Callable[[Any, Any], tuple[bytes, NDArray[np.generic]]]


def _image_decoder(route: Route) -> Any:
    return image_decoder(route.source_type, route.codec, most_pixels=route.most_pixels)


def _image_parts(header: Any, image: Any) -> tuple[bytes, NDArray[np.generic]]:
    return image_prefix(header, image.array, image.encoding), image.array


CODECS = {IMAGE_TYPE: StreamCodec(_image_decoder, _image_parts)}
"""Codecs by the ROS type of their decoded messages."""


def write_message(buffer: Any, prefix: bytes, items: NDArray[np.generic]) -> None:
    """Write a message, in the parts of `StreamCodec`, into a buffer of ``len(prefix) + items.nbytes`` bytes."""
    view = np.frombuffer(buffer, dtype=np.uint8)
    view[: len(prefix)] = np.frombuffer(prefix, dtype=np.uint8)
    view[len(prefix) : len(prefix) + items.nbytes] = items.reshape(-1).view(np.uint8)


def message_bytes(prefix: bytes, items: NDArray[np.generic]) -> bytes:
    """Return a message, given in the parts of `StreamCodec`, padded to a multiple of four bytes for the middleware."""
    body = prefix + items.tobytes()
    return body + bytes(-len(body) % 4)


LOCAL_QOS = QoSProfile(depth=5)  #: QoS on the device: reliable, so that every subscription matches.

#: Size of the images that a DDS writer keeps for a reader that lags behind, bytes, unless these are fewer images
#: than the depth of `LOCAL_QOS`.
HISTORY_BYTES = 64 << 20
_MAX_DEPTH = 256
_USUAL_PIXELS = 1280 * 720  # of a stream that does not announce its size
_PIXEL_BYTES = 3  # of the encoding bgr8


def dds_qos(route: Route) -> QoSProfile:
    """Return the QoS of a route's local DDS writer: `LOCAL_QOS`, for images with a deeper history.

    If a reader requests an image that the writer has overwritten, the writer sends a GAP. If a reader of Fast DDS
    (2.14 and 3.2) has received a part of this image, its next `take` can hang. With a deeper history, the
    reader has more time to request the image.
    """
    if route.codec == RELAY:
        return LOCAL_QOS  # a message fits one datagram
    pixels = _USUAL_PIXELS if route.most_pixels == MAX_PIXELS else route.most_pixels
    depth = min(HISTORY_BYTES // (pixels * _PIXEL_BYTES), _MAX_DEPTH)
    return replace(LOCAL_QOS, depth=max(depth, LOCAL_QOS.depth))


#: Time for a replay to connect, s; the live stream has sent a key frame by then.
REPLAY_TIMEOUT_S = 3.0


@dataclass(slots=True, kw_only=True)
class Statistics:
    """Counts of a pipeline since it was opened."""

    replayed: int = 0  #: Number of messages from the GOP replay.
    newest: int = -1  #: Number of the latest frame; -1 if there is none or frames have no numbers.
    broken: int = 0  #: Number of messages that could not be decoded.
    last_error: str = ""  #: Latest decoding error; empty without one.


class Outputs:
    """Local publishers of one topic: one for each subscribed transport, once it is open."""

    def __init__(self, local: Node, route: Route, transports: Iterable[str]) -> None:
        self._local = local
        self._route = route
        self._transports = frozenset(transports)
        self._is_open = False
        self._publishers: dict[str, Publisher] = {}

    def open(self) -> None:
        """Create the publishers of the decoded stream, one per requested transport."""
        self._is_open = True
        self.serve(self._transports)

    def serve(self, transports: Iterable[str]) -> None:
        """Serve exactly these transports: now, or from `open` on."""
        wanted = self._transports = frozenset(transports)
        if not self._is_open:
            return
        for gone in set(self._publishers) - wanted:
            self._publishers.pop(gone).close()
        for new in sorted(wanted - set(self._publishers)):
            self._publishers[new] = self._local.create_publisher(
                self._route.local_type,
                self._route.local_topic,
                dds_qos(self._route) if new == "dds" else LOCAL_QOS,
                transport=new,  # type: ignore[arg-type]  # the protocol carries text
            )

    def publish(self, prefix: bytes, items: NDArray[np.generic]) -> None:
        """Publish one message, in the parts of `StreamCodec`, over every transport in use."""
        for transport, publisher in self._publishers.items():
            if transport == "shm":
                with publisher.loan(len(prefix) + items.nbytes) as buffer:
                    write_message(buffer, prefix, items)
            else:
                publisher.publish_raw(message_bytes(prefix, items))

    def publish_raw(self, cdr: bytes) -> None:
        """Publish one message unchanged over every transport in use."""
        for publisher in self._publishers.values():
            publisher.publish_raw(cdr)

    def close(self) -> None:
        """Close all publishers; further calls have no effect."""
        self.serve(())


async def run_pipeline(route: Route, *, remote: Node, outputs: Outputs, counts: Statistics) -> None:
    """Decode or relay one stream from the remote node until cancelled, updating the counts.

    A message that cannot be decoded is counted and skipped: the next key frame heals the stream.

    Raises:
        CodecError: There is no decoder for this type and codec.
    """
    if route.codec == RELAY:
        await _relay(route, remote, outputs)
    else:
        await _decode(route, remote, outputs, counts)


async def _relay(route: Route, remote: Node, outputs: Outputs) -> None:
    with closing(
        remote.create_subscription(
            route.source_type, route.source_topic, qos=COMPRESSED_STREAM, raw=True
        )
    ) as subscription:
        outputs.open()
        async for cdr in subscription:
            outputs.publish_raw(cdr)


async def _decode(route: Route, remote: Node, outputs: Outputs, counts: Statistics) -> None:
    with ExitStack() as stack:

        def subscribe(topic: str, qos: QoSProfile) -> Subscription:
            subscription = remote.create_subscription(route.source_type, topic, qos=qos)
            stack.callback(subscription.close)
            return subscription

        # Remote topics come first and the replay before all others, because routers connect one topic after
        # the other.
        replay = subscribe(route.replay_topic, REPLAY_QOS) if route.replay_topic else None
        live = subscribe(route.source_topic, COMPRESSED_STREAM)
        outputs.open()
        decoding = _Decoding(route, outputs, counts)
        if replay is not None:
            await decoding.join(live, replay)
            replay.close()
        await decoding.follow(live)


class _Decoding:
    """Path of one stream's packets through the splicer and the decoder to the outputs."""

    def __init__(self, route: Route, outputs: Outputs, counts: Statistics) -> None:
        self._codec = CODECS[route.decoded_type]
        self._decoder = self._codec.decoder(route)
        self._numbered = bool(route.replay_topic)
        self._splicer = Splicer(replay=self._numbered, after=route.after)
        self._outputs = outputs
        self._counts = counts
        self._arrived = asyncio.Event()

    async def join(self, live: Subscription, replay: Subscription) -> None:
        """Decode packets of both sources until the live stream alone is enough."""
        sources = {Source.LIVE: live, Source.REPLAY: replay}
        async with beside(*(self._pump(s, source) for source, s in sources.items())) as pumps:
            try:
                async with asyncio.timeout(REPLAY_TIMEOUT_S):
                    while self._splicer.needs_replay:
                        await self._step_or_wait()
                        for pump in pumps:
                            if pump.done():
                                pump.result()
            except TimeoutError:
                self._splicer.give_up()

    async def follow(self, live: Subscription) -> None:
        """Decode the rest of the joining phase, and then the live stream as it arrives."""
        await self._drain()
        messages = aiter(live)
        while not self._splicer.done:
            self._take(await anext(messages), Source.LIVE)
            await self._drain()
        async for message in messages:
            await self._decode(message, show=not (self._numbered and message.flags & FLAG_DISCARD))

    async def _pump(self, subscription: Subscription, source: Source) -> None:
        try:
            async for message in subscription:
                self._take(message, source)
                self._arrived.set()
        finally:
            self._arrived.set()

    def _take(self, message: Any, source: Source) -> None:
        if source is Source.REPLAY:
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
        """Decode the next message; return False if there is none."""
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
        except (
            CodecError,
            InvalidMessageError,
        ) as error:  # or the image is too large to be published
            self._counts.broken += 1
            self._counts.last_error = str(error)
        # A burst of queued messages must not delay orders and newer messages.
        await asyncio.sleep(0)

    def _show(self, message: Any) -> None:
        for decoded in self._decoder.feed(message):
            self._outputs.publish(*self._codec.parts(message.header, decoded))
            self._counts.newest = message.pts if self._numbered else -1
