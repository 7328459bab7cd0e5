"""Backend of a simulated node, with endpoints and clock, and the node class, which can also crash."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from sfglab.bus.api import (
    EndpointInfo,
    EndpointKind,
    NodeInfo,
    RawEndpoint,
    ros_topic,
)
from sfglab.bus.backend import Backend, Clock
from sfglab.bus.graph import Graph
from sfglab.bus.node import Node
from sfglab.bus.sim.endpoints import Reader, Writer
from sfglab.bus.sim.loop import START_NS, VirtualLoop

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.endpoints import Inbox
    from sfglab.bus.loop import OnError
    from sfglab.bus.sim.domain import Participant


class SimClock(Clock):
    """Clock of a simulated world."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop

    def now_ns(self) -> int:
        """Return the current virtual time, in nanoseconds since the Unix epoch."""
        return START_NS + self._loop.now_ns


class SimGraph(Graph):
    """Graph of all endpoints that a participant has discovered; its nodes are those that have endpoints."""

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


class SimBackend(Backend):
    """Backend with a participant of a simulated domain, which it has joined."""

    kind = "simulated"

    def __init__(self, participant: Participant, on_error: OnError | None) -> None:
        super().__init__(on_error)
        self.participant = participant
        self.guid = participant.guid
        self.graph = participant.graph
        self.clock = SimClock(participant.domain.network.loop)

    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer; it refuses a message that DDS would not parse."""
        checks = endpoint.transport == "dds" and not endpoint.forwards and not endpoint.is_service
        writer = Writer(
            self.participant,
            self._info(endpoint, writer=True),
            notify,
            check=self.decoder(endpoint.type) if checks else None,
            limit_bytes=endpoint.max_message_bytes if endpoint.transport == "shm" else None,
            ignores_own=endpoint.forwards,
        )
        self.participant.open(writer)
        return writer

    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader."""
        info = self._info(endpoint, writer=False)
        reader = Reader(self.participant, info, notify, inbox=inbox, ignores_own=endpoint.forwards)
        self.participant.open(reader)
        return reader

    def random_bytes(self, count: int) -> bytes:
        """Return bytes that are unique among nodes, and the same in every run of the world."""
        return self.participant.domain.network.random.randbytes(count)

    def leave(self) -> None:
        """Leave the domain, unless the node has crashed."""
        if self.participant.is_alive:
            self.participant.domain.leave(self.participant)

    def crash(self) -> None:
        """Close everything now, without notice to other participants."""
        if not self.closed:
            self.closed = True
            self.participant.domain.crash(self.participant)
            self._end_all()

    def _info(self, endpoint: RawEndpoint, *, writer: bool) -> EndpointInfo:
        """Return the description of a new endpoint that other participants receive."""
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
    """Node of a simulated world; made by `World.node`."""

    def crash(self) -> None:
        """End without notice; others notice it when the lease has expired. Repeated calls are harmless."""
        if self._live is not None:
            cast("SimBackend", self._live).crash()
