"""GOP cache: keeps every stream's last group of pictures near its camera and replays it to late joiners.

Without it, a subscriber waits for the next key frame, half a second on average with the groups of Table 2
(paper A, section 5.4). `sfglab.fleet.decoder.splicer` is the receiving side. The cache subscribes to the
compressed streams in the agent's domain, where a copy needs no radio. It offers each stream's replay on a
companion topic, and writes only while that topic has a reader. A reader receives the packets since the last
key frame at once, all but the newest with `FLAG_DISCARD`. Every later packet follows as it arrives, until
the reader has reached the live stream and leaves.

As a process (``python -m sfglab.fleet.gop_cache CONFIG``; see `sfglab.component`) it reports, beside
``ready``, every replay, ``{"is": "replayed", "topic", "packets", "size_bytes"}``.
"""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointEvent, EndpointKind
from sfglab.component import Reporter, beside, run_component
from sfglab.fleet.gop_config import (
    FFMPEG_PACKET,
    FLAG_DISCARD,
    FLAG_KEY,
    REPLAY_DEPTH,
    REPLAY_QOS,
    GopCacheConfig,
    replay_topic,
)
from sfglab.messages.packets import PacketOrder
from sfglab.names import ResourceKind, dds_names
from sfglab.qos import COMPRESSED_STREAM, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.bus import Node

#: Time between the discovery of the first reader and the replay, s. A router opens both its sides at once. Packets
#: that are sent before its other side is matched are retransmitted later. Over two routers a replay took 0.11 s
#: without this wait and 0.02 s with it.
SETTLE_S = 0.01
MAX_GROUP_BYTES = 8_000_000  #: Maximum size of a kept group: two seconds of 32 Mbit/s.


class GopCache:
    """Current group of pictures of a stream; empty after a gap or overflow until the next key frame.

    The arguments are the maximum number and the maximum total size, bytes, of its packets.
    """

    def __init__(self, max_packets: int = REPLAY_DEPTH, max_bytes: int = MAX_GROUP_BYTES) -> None:
        self.size_bytes = 0  #: Size of the kept packets, bytes.
        self._max_packets = max_packets
        self._max_bytes = max_bytes
        self._packets: list[Any] = []
        self._order = PacketOrder()

    def __len__(self) -> int:
        return len(self._packets)

    @property
    def packets(self) -> tuple[Any, ...]:
        """Kept packets, the key frame first."""
        return tuple(self._packets)

    def add(self, packet: Any, *, pts: int, is_key: bool, size_bytes: int) -> bool:
        """Process the next packet, in the order of `PacketOrder`; return whether it is kept."""
        is_missing = self._order.missing(pts)
        if is_key:
            self._clear()
        elif not self._packets:
            return False
        is_full = len(self._packets) >= self._max_packets
        if is_full or self.size_bytes + size_bytes > self._max_bytes or (is_missing and not is_key):
            self._clear()
            return False
        self._packets.append(packet)
        self.size_bytes += size_bytes
        return True

    def _clear(self) -> None:
        self._packets.clear()
        self.size_bytes = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """One replay of a stream that a GOP cache sent to a new subscriber."""

    topic: str  #: Topic of the stream.
    packets: int  #: Number of packets since the last key frame.
    size_bytes: int  #: Size of these packets, bytes.


class GopCacheNode:
    """Node that keeps and replays streams in an agent's domain; `on_replay` is called with every replay."""

    def __init__(
        self,
        node: Node,
        streams: Iterable[str],
        *,
        on_replay: Callable[[Replayed], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._topics = tuple(streams)
        self._on_replay = on_replay

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until cancelled, from `on_ready` on; everything it opened is closed when this returns."""
        streams = [_Stream(self._node, topic, self._on_replay) for topic in self._topics]
        async with beside(*(stream.run() for stream in streams)) as tasks:
            on_ready()
            await asyncio.gather(*tasks)
            await asyncio.Event().wait()  # there may be no streams


class _Stream:
    """One stream with its cache and its replay."""

    def __init__(self, node: Node, topic: str, on_replay: Callable[[Replayed], None]) -> None:
        self._node = node
        self._topic = topic
        self._replay_topic = str(replay_topic(topic))
        self._on_replay = on_replay
        self._cache = GopCache()
        self._readers: set[bytes] = set()
        # wait until the connections to the first reader settle
        self._timer: asyncio.Task[None] | None = None
        self._is_serving = False  # whether the group was sent, so that every packet follows
        self._publisher = self._advertise()

    async def run(self) -> None:
        (dds_topic,) = dds_names(self._replay_topic, ResourceKind.TOPIC)
        subscription = self._node.create_subscription(
            FFMPEG_PACKET, self._topic, qos=COMPRESSED_STREAM
        )
        unwatch = self._node.graph.watch(dds_topic, EndpointKind.SUBSCRIPTION, self._on_event)
        try:
            async for packet in subscription:
                is_key, size = bool(packet.flags & FLAG_KEY), len(packet.data)
                kept = self._cache.add(packet, pts=packet.pts, is_key=is_key, size_bytes=size)
                if kept and self._is_serving:
                    self._publisher.publish(packet)
        finally:
            unwatch()
            self._cancel_timer()
            subscription.close()
            self._publisher.close()

    def _on_event(self, event: EndpointEvent) -> None:
        endpoint = event.endpoint
        matches = not incompatibilities(offered=REPLAY_QOS, requested=endpoint.qos)
        if isinstance(event, EndpointAdded) and matches and endpoint.transport == "dds":
            self._readers.add(endpoint.gid)
        else:
            self._readers.discard(endpoint.gid)
        if not self._readers:
            self._stop()
        elif not self._is_serving and self._timer is None:
            self._timer = asyncio.create_task(self._serve())

    async def _serve(self) -> None:
        await asyncio.sleep(SETTLE_S)
        self._timer = None
        self._is_serving = True
        *old, newest = self._cache.packets or (None,)
        for packet in old:
            self._publisher.publish(replace(packet, flags=packet.flags | FLAG_DISCARD))
        if newest is not None:
            self._publisher.publish(newest)
        packets = len(self._cache)
        size_bytes = self._cache.size_bytes
        self._on_replay(Replayed(topic=self._topic, packets=packets, size_bytes=size_bytes))

    def _stop(self) -> None:
        self._cancel_timer()
        if self._is_serving:
            self._is_serving = False
            # The history of a transient-local writer cannot be withdrawn; a new writer has none.
            self._publisher.close()
            self._publisher = self._advertise()

    def _advertise(self) -> Any:
        return self._node.create_publisher(FFMPEG_PACKET, self._replay_topic, REPLAY_QOS)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


async def run_gop_cache(config: GopCacheConfig, report: Reporter) -> None:
    """Run a GOP cache until cancelled; everything it started has ended when this returns.

    Raises:
        BusError: The domain cannot be joined.
    """
    from sfglab.bus import Node

    def on_replay(replayed: Replayed) -> None:
        report({"is": "replayed", **asdict(replayed)})

    async with Node("stream_keeper", **config.address.options()) as node:
        cache = GopCacheNode(node, config.streams, on_replay=on_replay)
        await cache.run(on_ready=lambda: report({"is": "ready"}))


if __name__ == "__main__":
    run_component(GopCacheConfig, lambda config, report, _: run_gop_cache(config, report))
