"""A simulated node's half of its world: its graph, endpoints and clock, and the node, which can also crash."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

from sfglab import names
from sfglab.bus.api import (
    EndpointEvent,
    EndpointInfo,
    EndpointKind,
    Listener,
    NodeInfo,
    RawEndpoint,
    ros_topic,
)
from sfglab.bus.backend import Backend, Clock
from sfglab.bus.graph import Graph
from sfglab.bus.node import Node
from sfglab.bus.sim.discovery import Discovery, Watch
from sfglab.bus.sim.loop import START_NS, VirtualLoop
from sfglab.bus.sim.network import Network, Reader, Services
from sfglab.bus.sim.writer import Writer
from sfglab.messages import decoder

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterable
    from random import Random

    from sfglab.bus.endpoints import Inbox
    from sfglab.bus.endpoints import Reader as AnyReader
    from sfglab.bus.loop import OnError
    from sfglab.bus.sim.model import Endpoint, Participant

_LIMIT_BYTES = 64 * 2**20
# Of a kept message's Python objects, roughly, so that many small ones are bounded too.
_OVERHEAD_BYTES = 1000


class SimClock(Clock):
    """The time of a simulated world."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop

    def now_ns(self) -> int:
        """Return the current virtual time, in nanoseconds since the Unix epoch."""
        return START_NS + self._loop.now_ns


class SharedDecoder:
    """CDR to messages of one type: decoded once, equal bytes give the same object while it is remembered."""

    def __init__(self, type_: str) -> None:
        self._decode: Callable[[bytes], Any] = decoder(type_)
        self._known: dict[bytes, Any] = {}
        self._size_bytes = 0

    def __call__(self, cdr: bytes) -> Any:
        """Return the message.

        Raises:
            CdrError: The bytes are no message of the type.
        """
        message = self._known.get(cdr)
        if message is None:
            message = self._decode(cdr)
            self._size_bytes += len(cdr) + _OVERHEAD_BYTES
            if self._size_bytes > _LIMIT_BYTES:
                self._known.clear()
                self._size_bytes = len(cdr) + _OVERHEAD_BYTES
            self._known[cdr] = message
        return message


@dataclass(frozen=True, slots=True)
class Fabric:
    """What the nodes of a world share to talk by."""

    network: Network  #: Delivers samples.
    services: Services | None  #: Knows who asked, if replies shall go only there.
    random: Random  #: Draws ids.
    decoders: dict[str, SharedDecoder] = field(default_factory=dict)  #: By type.


class SimGraph(Graph):
    """All endpoints that a participant knows of, its own included.

    It hears of every event only while somebody listens to all: nodes that watch a few topics cost what these
    cost.
    """

    def __init__(self, participant: Participant, discovery: Discovery) -> None:
        super().__init__(participant.domain.environment.loop)
        self.participant = participant
        self._discovery = discovery
        self._domain = participant.domain
        self._users = 0

    def endpoints(self) -> tuple[EndpointInfo, ...]:
        """Return all known endpoints, ordered by gid."""
        return self._known(self._domain.endpoints())

    def nodes(self) -> tuple[NodeInfo, ...]:
        """Return the nodes that have endpoints here, ordered by name."""
        gids: dict[tuple[str, bytes], tuple[list[bytes], list[bytes]]] = {}
        for endpoint in self.endpoints():
            readers, writers = gids.setdefault((endpoint.node, endpoint.participant), ([], []))
            (writers if endpoint.kind is EndpointKind.PUBLISHER else readers).append(endpoint.gid)
        return tuple(
            NodeInfo(
                namespace=name.rpartition("/")[0] or "/",
                name=name.rpartition("/")[2],
                participant=participant,
                readers=tuple(readers),
                writers=tuple(writers),
            )
            for (name, participant), (readers, writers) in sorted(gids.items())
        )

    async def events(self) -> AsyncIterator[EndpointEvent]:
        """Yield an `EndpointAdded` for every endpoint known now, then every change until the node closes."""
        self._attach()
        try:
            async for event in super().events():
                yield event
        finally:
            self._detach()

    async def wait_for(self, predicate: Callable[[], bool], timeout_s: float = 5.0) -> bool:
        """Return True once a predicate over this graph holds, False when it did not within `timeout_s`."""
        self._attach()
        try:
            return await super().wait_for(predicate, timeout_s)
        finally:
            self._detach()

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` for every endpoint known now and every change; return what ends that."""
        self._attach()
        unlisten = super().listen(listener)
        ended = False

        def end() -> None:
            nonlocal ended
            unlisten()
            if not ended:
                ended = True
                self._detach()

        return end

    def watch(self, dds_topic: str, kind: EndpointKind, listener: Listener) -> Callable[[], None]:
        """Call `listener` as `listen` does, but only for endpoints of one kind on one topic of the wire."""
        watch = Watch(self.participant, listener)
        return self._discovery.watch(watch, dds_topic, writers=kind is EndpointKind.PUBLISHER)

    def learn(self, endpoint: Endpoint) -> None:
        """Tell the listeners of an endpoint."""
        self.apply([(endpoint.gid, endpoint.info)])

    def forget(self, endpoint: Endpoint) -> None:
        """Tell the listeners that an endpoint has gone."""
        self.apply([(endpoint.gid, None)])

    def _attach(self) -> None:
        self._users += 1
        if self._users == 1:
            self._domain.graphs[self] = None
            self._discovery.show(self, sorted(self._domain.endpoints(), key=lambda e: e.gid))

    def _detach(self) -> None:
        self._users -= 1
        if not self._users:
            self._domain.graphs.pop(self, None)
            self._endpoints.clear()

    def _select(self, topic: str, kind: EndpointKind) -> tuple[EndpointInfo, ...]:
        try:
            dds_topic = names.dds_topic(topic)
        except names.FqnError:
            dds_topic = topic
        index = self._domain.topics.get(dds_topic)
        return (
            ()
            if index is None
            else self._known(e for e in index.endpoints() if e.info.kind is kind)
        )

    def _known(self, endpoints: Iterable[Endpoint]) -> tuple[EndpointInfo, ...]:
        knows, participant = self._discovery.views.knows, self.participant
        return tuple(
            sorted((e.info for e in endpoints if knows(participant, e)), key=lambda i: i.gid)
        )


class SimBackend(Backend):
    """A participant of a simulated domain, which it has joined."""

    kind = "simulated"

    def __init__(
        self,
        participant: Participant,
        discovery: Discovery,
        fabric: Fabric,
        on_error: OnError | None,
    ) -> None:
        super().__init__(on_error)
        environment = participant.domain.environment
        self.participant = participant
        self.guid = participant.guid
        self.graph = SimGraph(participant, discovery)
        self.clock = SimClock(environment.loop)
        self._fabric = fabric
        self._discovery = discovery

    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer; a message that DDS would not parse it refuses."""
        checks = endpoint.transport == "dds" and not endpoint.forwards and not endpoint.is_service
        writer = Writer(
            self.participant,
            self._info(endpoint, writer=True),
            notify,
            network=self._fabric.network,
            accounts=self._discovery.accounts,
            services=self._fabric.services,
            check=self.decoder(endpoint.type) if checks else None,
            limit_bytes=endpoint.max_message_bytes if endpoint.transport == "shm" else None,
            ignores_own=endpoint.forwards,
        )
        self._discovery.open(writer)
        return writer

    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader."""
        info = self._info(endpoint, writer=False)
        reader = Reader(
            self.participant, info, notify, push=inbox.push, ignores_own=endpoint.forwards
        )
        self._discovery.open(reader)
        return reader

    def watch_publishers(
        self, reader: AnyReader, endpoint: RawEndpoint, listener: Listener
    ) -> Callable[[], None]:
        """Tell a listener of the publishers that do not match a reader, and of no others."""
        del endpoint
        return self._discovery.suspect(cast("Reader", reader), listener)

    def decoder(self, type_: str) -> SharedDecoder:
        """Return what decodes a type's messages for all who receive them."""
        if type_ not in self._fabric.decoders:
            self._fabric.decoders[type_] = SharedDecoder(type_)
        return self._fabric.decoders[type_]

    def random_bytes(self, count: int) -> bytes:
        """Return bytes that no other node has, the same in every run of the world."""
        return self._fabric.random.randbytes(count)

    def leave(self) -> None:
        """Leave the domain, unless the node has crashed."""
        if self.participant.alive:
            self._discovery.leave(self.participant)

    def crash(self) -> None:
        """End everything now without a word to the others."""
        if self.closed:
            return
        self.closed = True
        endpoints = list(self.participant.endpoints)
        self._discovery.crash(self.participant)
        for endpoint in endpoints:
            endpoint.silence()
        self._end_all()

    def _info(self, endpoint: RawEndpoint, *, writer: bool) -> EndpointInfo:
        """Return what the others are shown of a new endpoint."""
        participant = self.participant
        return EndpointInfo(
            kind=EndpointKind.PUBLISHER if writer else EndpointKind.SUBSCRIPTION,
            topic=ros_topic(endpoint.dds_topic),
            type=endpoint.type,
            gid=participant.new_gid(writer=writer),
            qos=endpoint.qos,
            transport=endpoint.transport,
            participant=participant.guid,
            host=participant.host.id,
            node=participant.name,
            dds_topic=endpoint.dds_topic,
            user_data=endpoint.user_data,
        )


class SimNode(Node):
    """A node of a simulated world, made by `World.node`. Subscriptions share messages: treat as read only."""

    def crash(self) -> None:
        """Die without a word: the others notice when the lease has run out; again is harmless."""
        if self._live is not None:
            cast("SimBackend", self._live).crash()
