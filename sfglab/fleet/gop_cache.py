"""GOP cache: every stream's last group of pictures, kept beside its camera and replayed to late joiners.

Paper A, section 5.4: a subscriber waits for the next key frame, half a second on average with the groups of
Table 2; the other end is `sfglab.fleet.decoder.splicer`. It subscribes to the compressed streams in the agent's
own domain, where a copy costs no air, and offers each stream's replay on a companion topic. While nobody reads
that, nothing is written. When somebody does, the packets since the last key frame are sent in one go, all but
the newest marked as not to be shown (`FLAG_DISCARD`), and every packet follows as it comes, until the reader
has caught up with the stream itself and leaves.

As a process (``python -m sfglab.fleet.gop_cache CONFIG``; see `sfglab.component`) it reports, beside ``ready``,
every replay, ``{"is": "replayed", "topic", "packets", "size_bytes", "gaps", "overflows"}``.
"""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass, field, replace
from enum import Enum, auto
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from sfglab.bus.address import BusAddress
from sfglab.bus.api import EndpointAdded, EndpointEvent, EndpointKind
from sfglab.component import Reporter, beside, run_component, steady_ns
from sfglab.errors import InvalidValueError
from sfglab.machine import Machine
from sfglab.messages.packets import PacketOrder
from sfglab.names import FqnError, Resource, ResourceKind, Suffixed, dds_names, parse
from sfglab.qos import COMPRESSED_STREAM, Durability, QoSProfile, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Node

FFMPEG_PACKET = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"  #: Of streams and of replays.

#: In the flags of a packet where a decoder may start (libavcodec, packet.h: AV_PKT_FLAG_KEY).
FLAG_KEY = 1

FLAG_DISCARD = 4  #: In the flags of a packet whose own picture nobody wants (AV_PKT_FLAG_DISCARD).

REPLAY_DEPTH = 256  #: The longest group of pictures, in packets: as deep as a router's reader.

REPLAY_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=REPLAY_DEPTH)
"""Reliable, as one lost packet spoils a group; latched, so that a router that still connects loses none."""


def replay_topic(stream_topic: str) -> str | None:
    """Return the companion ``<...>/ffmpeg_replay`` of a stream; None without the resource ``ffmpeg``."""
    try:
        fqn = parse(stream_topic)
    except FqnError:
        return None
    if fqn.resource is Resource.FFMPEG:
        return str(replace(fqn, resource=Resource.FFMPEG_REPLAY))
    if isinstance(fqn.resource, Suffixed) and fqn.resource.base is Resource.FFMPEG:
        return str(replace(fqn, resource=Resource.FFMPEG_REPLAY.suffixed(fqn.resource.suffix)))
    return None


M = TypeVar("M")


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much of one stream is kept."""

    packets: int = 256  #: The longest group of pictures, in packets.
    size_bytes: int = 8_000_000  #: The largest one. The default is two seconds of 32 Mbit/s.

    def __post_init__(self) -> None:
        for name in ("packets", "size_bytes"):
            if (given := getattr(self, name)) < 1:
                raise InvalidValueError(f"group of pictures, {name}", given, "1 or more")


class GopCache(Generic[M]):
    """Keeps the current group of pictures; after a gap or overflow nothing until the next key frame."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.size_bytes = 0  #: Size of what is kept.
        self.gaps = 0  #: How often packets went missing.
        self.overflows = 0  #: How often a group outgrew the limits.
        self._limits = limits or Limits()
        self._packets: list[M] = []
        self._order = PacketOrder()

    def __len__(self) -> int:
        return len(self._packets)

    @property
    def packets(self) -> tuple[M, ...]:
        """The packets that are kept, the key frame first."""
        return tuple(self._packets)

    def add(self, packet: M, *, pts: int, is_key: bool, size_bytes: int) -> bool:
        """Take the next packet, in the order of `PacketOrder`; return whether it is kept."""
        is_missing = self._order.missing(pts)
        if is_key:
            self._clear()
        elif not self._packets:
            return False
        elif is_missing:
            self.gaps += 1
            self._clear()
            return False
        if (
            len(self._packets) >= self._limits.packets
            or self.size_bytes + size_bytes > self._limits.size_bytes
        ):
            self.overflows += 1
            self._clear()
            return False
        self._packets.append(packet)
        self.size_bytes += size_bytes
        return True

    def _clear(self) -> None:
        self._packets.clear()
        self.size_bytes = 0


class State(Enum):
    """Where a stream's replay stands."""

    IDLE = auto()  #: Nobody reads it; nothing is written.
    #: The first reader came a moment ago; the way to it is still being connected.
    SETTLING = auto()
    SERVING = auto()  #: The group was sent; every packet follows as it comes.


class Input(Enum):
    """What can happen to a replay."""

    READ = auto()  #: The first reader appeared.
    UNREAD = auto()  #: The last reader left.
    TIMER = auto()  #: The armed timer ran out.


class Action(Enum):
    """What the caller has to do after a transition."""

    SETTLE = auto()  #: Arm the timer.
    CANCEL = auto()  #: Nothing is waited for any more.
    BURST = auto()  #: Send all that is kept.
    RENEW = auto()  #: Forget what was sent, so that the next reader does not hear it.


_S, _I, _A = State, Input, Action

TRANSITIONS: dict[tuple[State, Input], tuple[State, Action | None]] = {
    (_S.IDLE, _I.READ): (_S.SETTLING, _A.SETTLE),
    (_S.SETTLING, _I.TIMER): (_S.SERVING, _A.BURST),
    (_S.SETTLING, _I.UNREAD): (_S.IDLE, _A.CANCEL),
    (_S.SERVING, _I.UNREAD): (_S.IDLE, _A.RENEW),
}
"""(state, input) -> (next state, action). What is not listed is illegal."""


def session(name: str, *, settle_ns: int) -> Machine[State, Input, Action]:
    """Return the machine of one stream's replay, which lets connections to a reader settle for a while."""

    def wait_ns(action: Action, _: int) -> int | None:
        return settle_ns if action is Action.SETTLE else None

    return Machine(name, TRANSITIONS, State.IDLE, wait_ns=wait_ns)


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
                raise InvalidValueError(
                    "stream", topic, "topics of the schema that end in 'ffmpeg'"
                )
        if self.limits.packets > REPLAY_DEPTH:
            raise InvalidValueError(
                "group of pictures, packets", self.limits.packets, f"1 to {REPLAY_DEPTH}"
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
    """Keeps and replays streams in an agent's own domain; `on_replay` is told about every replay."""

    def __init__(
        self,
        node: Node,
        settings: KeeperSettings,
        *,
        on_replay: Callable[[Replayed], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._settings = settings
        self._on_replay = on_replay

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until cancelled, from `on_ready` on; everything it opened is closed when this returns."""
        streams = [
            _Stream(self._node, t, self._settings, self._on_replay) for t in self._settings.streams
        ]
        async with beside(*(stream.run() for stream in streams)) as tasks:
            on_ready()
            await asyncio.gather(*tasks)
            await asyncio.Event().wait()  # there may be no streams


class _Stream:
    """One stream: its cache, and its replay."""

    def __init__(
        self,
        node: Node,
        topic: str,
        settings: KeeperSettings,
        on_replay: Callable[[Replayed], None],
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
        subscription = self._node.create_subscription(
            FFMPEG_PACKET, self._topic, qos=COMPRESSED_STREAM
        )
        unwatch = self._node.graph.watch(dds_topic, EndpointKind.SUBSCRIPTION, self._count_reader)
        try:
            async for packet in subscription:
                is_key = bool(packet.flags & FLAG_KEY)
                kept = self._cache.add(
                    packet, pts=packet.pts, is_key=is_key, size_bytes=len(packet.data)
                )
                if kept and self._session.state is State.SERVING:
                    self._publisher.publish(packet)
        finally:
            unwatch()
            self._cancel_timer()
            subscription.close()
            self._publisher.close()

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
        action = self._session.feed(given, now_ns=steady_ns())
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
        while not self._session.due(now_ns := steady_ns()):
            assert self._session.deadline_ns is not None
            await asyncio.sleep(max(0.0, (self._session.deadline_ns - now_ns) / 1e9))
        self._timer = None
        self._feed(Input.TIMER)

    def _burst(self) -> None:
        *old, newest = self._cache.packets or (None,)
        for packet in old:
            self._publisher.publish(replace(packet, flags=packet.flags | FLAG_DISCARD))
        if newest is not None:
            self._publisher.publish(newest)
        cache, size = self._cache, self._cache.size_bytes
        sent = Replayed(
            topic=self._topic,
            packets=len(cache),
            size_bytes=size,
            gaps=cache.gaps,
            overflows=cache.overflows,
        )
        self._on_replay(sent)

    def _offer(self) -> Any:
        return self._node.create_publisher(FFMPEG_PACKET, self._replay_topic, REPLAY_QOS)

    def _cancel_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


@dataclass(frozen=True, slots=True, kw_only=True)
class KeeperConfig(KeeperSettings):
    """What a keeper's process is told, beside what it keeps."""

    address: BusAddress  #: The agent's own domain.


async def run_keeper(config: KeeperConfig, report: Reporter) -> None:
    """Run a keeper until cancelled and all it started has ended; `BusError` if it cannot join the domain."""
    from sfglab.bus import Node

    async with Node("stream_keeper", **config.address.options()) as node:
        keeper = StreamKeeper(
            node, config, on_replay=lambda r: report({"is": "replayed", **asdict(r)})
        )
        await keeper.run(on_ready=lambda: report({"is": "ready"}))


if __name__ == "__main__":
    run_component(KeeperConfig, lambda config, report, _: run_keeper(config, report))
