"""The keeper: holds every stream's last group of pictures beside its camera and replays it to late joiners.

It subscribes to the compressed streams in the agent's own domain, where a copy costs no air, and offers each
stream's replay on a companion topic. While nobody reads that, nothing is written. When somebody does, the
packets since the last key frame are sent in one go, all but the newest marked as not to be shown
(`FLAG_DISCARD`), and every packet follows as it comes, until the reader has caught up with the stream itself
and leaves.

Other ways were measured, over two routers with groups of 30 packets of 17 kB:

* A latched topic that is always written, whose history DDS sends to late joiners by itself, is as quick and as
  cheap. But a history counts samples, not groups: its depth has to be the group's length, all of it is sent,
  523 kB a join where this sends 262 kB on average, and the useless packets before the key frame come first;
  on a link of 20 Mbit/s that is 0.32 s in place of 0.21 s. And it cannot mark packets.
* One latched message with the whole group, written anew for every frame, costs 0.1 % of a core while nobody
  reads it, and 60 Mbit/s while somebody does.
* A service would need its requests and its replies connected through both routers, and no caller can know when
  they are.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointKind
from sfglab.errors import SfglabError
from sfglab.fleet.keeper.cache import GopCache, Limits
from sfglab.fleet.keeper.session import Action, Input, State, session
from sfglab.fleet.keeper.topics import (
    FFMPEG_PACKET,
    FLAG_DISCARD,
    FLAG_KEY,
    REPLAY_DEPTH,
    REPLAY_QOS,
    replay_topic,
)
from sfglab.names import ResourceKind, dds_names
from sfglab.qos import COMPRESSED_STREAM, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Node
    from sfglab.bus.api import EndpointEvent


class KeeperError(SfglabError, ValueError):
    """A stream that cannot be replayed, or a limit beyond what a replay can hold."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeeperSettings:
    """What a keeper keeps."""

    streams: tuple[str, ...] = ()  #: The compressed streams, by their topics.
    limits: Limits = field(default_factory=Limits)  #: How much of each.
    #: How long after its first reader appeared a replay is sent, seconds. A router opens both its sides at
    #: once, and what is sent before its other side is matched has to be asked for again: over two routers a
    #: replay took 0.11 s without this wait and 0.02 s with it.
    settle_s: float = 0.01

    def __post_init__(self) -> None:
        for topic in self.streams:
            if replay_topic(topic) is None:
                raise KeeperError(f"stream {topic!r}: allowed are topics of the schema that end in 'ffmpeg'")
        if self.limits.packets > REPLAY_DEPTH:
            raise KeeperError(
                f"group of pictures: given {self.limits.packets} packets, allowed are 1 to {REPLAY_DEPTH}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Replayed:
    """One replay that was sent."""

    topic: str  #: The stream's topic.
    packets: int  #: Packets since the last key frame.
    size_bytes: int  #: Their size.
    gaps: int  #: How often packets of the stream went missing on their way here.
    overflows: int  #: How often a group of pictures was longer than what is kept.


class StreamKeeper:
    """Keeps and replays streams for one agent.

    Args:
        node: Node in the agent's own domain.
        settings: What it keeps.
        on_replay: Told about every replay.
    """

    def __init__(
        self, node: Node, settings: KeeperSettings, *, on_replay: Callable[[Replayed], None] = lambda _: None
    ) -> None:
        self._node = node
        self._settings = settings
        self._on_replay = on_replay

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until cancelled; everything it opened is closed when this returns.

        Args:
            on_ready: Called once when it keeps.
        """
        streams = [_Stream(self._node, t, self._settings, self._on_replay) for t in self._settings.streams]
        tasks = [asyncio.create_task(stream.run()) for stream in streams]
        on_ready()
        try:
            await asyncio.gather(*tasks)
            await asyncio.Event().wait()  # there may be no streams
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


class _Stream:
    """One stream: its cache, and its replay."""

    def __init__(
        self, node: Node, topic: str, settings: KeeperSettings, on_replay: Callable[[Replayed], None]
    ) -> None:
        self._node = node
        self._topic = topic
        self._replay_topic = str(replay_topic(topic))
        self._on_replay = on_replay
        self._cache: GopCache[Any] = GopCache(settings.limits)
        self._session = session(f"replay of {topic}", settle_ns=round(settings.settle_s * 1e9))
        self._readers: set[bytes] = set()
        self._timer: asyncio.Task[None] | None = None
        self._publisher = self._offer()

    async def run(self) -> None:
        (dds_topic,) = dds_names(self._replay_topic, ResourceKind.TOPIC)
        subscription = self._node.create_subscription(FFMPEG_PACKET, self._topic, qos=COMPRESSED_STREAM)
        unwatch = self._node.graph.watch(dds_topic, EndpointKind.SUBSCRIPTION, self._count_reader)
        try:
            async for packet in subscription:
                self._keep(packet)
        finally:
            unwatch()
            self._cancel_timer()
            subscription.close()
            self._publisher.close()

    def _keep(self, packet: Any) -> None:
        is_key = bool(packet.flags & FLAG_KEY)
        kept = self._cache.add(packet, pts=packet.pts, is_key=is_key, size_bytes=len(packet.data))
        if kept and self._session.state is State.SERVING:
            self._publisher.publish(packet)

    def _count_reader(self, event: EndpointEvent) -> None:
        endpoint = event.endpoint
        matches = not incompatibilities(offered=REPLAY_QOS, requested=endpoint.qos)
        if isinstance(event, EndpointAdded) and matches and endpoint.transport == "dds":
            self._readers.add(endpoint.gid)
        else:
            self._readers.discard(endpoint.gid)
        given = Input.READ if self._readers else Input.UNREAD
        if self._session.allows(given):
            self._feed(given)

    def _feed(self, given: Input) -> None:
        action = self._session.feed(given, now_ns=self._node.get_clock().now_ns())
        if action is Action.SETTLE:
            self._timer = asyncio.create_task(self._settle())
        elif action is Action.CANCEL:
            self._cancel_timer()
        elif action is Action.BURST:
            self._burst()
        elif action is Action.RENEW:
            # A latched writer's history cannot be taken back; a new writer has none.
            self._publisher.close()
            self._publisher = self._offer()

    async def _settle(self) -> None:
        clock = self._node.get_clock()
        while not self._session.due(clock.now_ns()):
            assert self._session.deadline_ns is not None
            await clock.sleep_for(max(0.0, (self._session.deadline_ns - clock.now_ns()) / 1e9))
        self._timer = None
        self._feed(Input.TIMER)

    def _burst(self) -> None:
        *old, newest = self._cache.packets or (None,)
        for packet in old:
            self._publisher.publish(replace(packet, flags=packet.flags | FLAG_DISCARD))
        if newest is not None:
            self._publisher.publish(newest)
        self._on_replay(
            Replayed(
                topic=self._topic,
                packets=len(self._cache),
                size_bytes=self._cache.size_bytes,
                gaps=self._cache.gaps,
                overflows=self._cache.overflows,
            )
        )

    def _offer(self) -> Any:
        return self._node.create_publisher(FFMPEG_PACKET, self._replay_topic, REPLAY_QOS)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
