"""What a simulated node owns, shaped as `sfglab.bus.core.Core`, so that the bus's own classes work on it."""

from __future__ import annotations

import asyncio
from functools import cache
from typing import TYPE_CHECKING, Any, cast

from sfglab import names
from sfglab.bus.api import EndpointInfo, EndpointKind
from sfglab.bus.bridge import LoopBridge
from sfglab.bus.calls import Calls, OnError
from sfglab.bus.forwarding import RawEndpoint
from sfglab.bus.mismatch import MismatchWatch
from sfglab.bus.sim.domain import Watch
from sfglab.bus.sim.graph import SimGraph
from sfglab.bus.sim.reader import Reader
from sfglab.bus.sim.writer import Writer
from sfglab.messages import service_type, type_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import EndpointEvent, Transport
    from sfglab.bus.core import Owned
    from sfglab.bus.graph import Graph
    from sfglab.bus.inbox import Inbox
    from sfglab.bus.sim.participant import Participant
    from sfglab.bus.transports import ServiceSide, Target


class SimCore:
    """A participant, its graph, and the endpoints, timers and tasks to end.

    Args:
        participant: The node's place in its domain.
        on_error: Told about exceptions in callbacks; None logs them.
    """

    def __init__(self, participant: Participant, on_error: OnError | None) -> None:
        self.world = participant.domain.world
        self.loop = self.world.loop
        self.bridge = _Bridge(self.loop)
        self.participant = participant
        self.graph = SimGraph(participant)
        self.closed = False
        self._on_error = on_error
        self._owned: dict[Owned, None] = {}
        self._tasks: set[asyncio.Task[Any]] = set()  # they hash by number, so every run walks them alike

    def calls(self, where: str) -> Calls:
        """Return a runner for the callbacks of one endpoint."""
        return Calls(self._tasks, where, self._on_error)

    def random_bytes(self, count: int) -> bytes:
        """Return bytes that no other node has, the same in every run of the world."""
        return self.world.random.randbytes(count)

    def own(self, thing: Owned) -> None:
        """Close `thing` when the node closes."""
        self._owned[thing] = None

    def disown(self, thing: Owned) -> None:
        """Forget a thing that was closed before its node."""
        self._owned.pop(thing, None)

    def open_writer(
        self, target: Target, transport: Transport, *, notify: Callable[[], None], max_message_bytes: int
    ) -> Writer:
        """Return the sending side of a new publisher."""
        info = self.info(_raw(target), writer=True, transport=transport)
        limit_bytes = max_message_bytes if transport == "shm" else None
        return Writer(self.participant, info, notify, limit_bytes=limit_bytes).opened()

    def open_reader(
        self, target: Target, transport: Transport, *, notify: Callable[[], None], inbox: Inbox
    ) -> tuple[Reader, MismatchWatch]:
        """Return the receiving side of a new subscription, and what warns of publishers that do not match."""
        info = self.info(_raw(target), writer=False, transport=transport)
        reader = Reader(self.participant, info, notify, push=inbox.push)
        watch = MismatchWatch(cast("Graph", _Mismatches(reader)), target, transport)
        return reader.opened(), watch

    def open_service_side(
        self, side: ServiceSide, *, inbox: Inbox, notify: Callable[[], None]
    ) -> tuple[Writer, Reader]:
        """Return what one side of a service sends and receives by."""
        topics, service = names.dds_service(side.name), service_type(side.type)
        halves = [
            RawEndpoint(dds_topic=topic, type=type_name(type_), qos=side.qos, user_data=side.user_data)
            for topic, type_ in zip(topics, (service.request, service.response), strict=True)
        ]
        in_, out = halves if side.server else reversed(halves)
        writer = _FrameWriter(self.participant, self.info(out, writer=True), notify)
        reader = Reader(self.participant, self.info(in_, writer=False), notify, push=inbox.push)
        return writer.opened(), reader.opened()

    def info(self, endpoint: RawEndpoint, *, writer: bool, transport: Transport = "dds") -> EndpointInfo:
        """Return what the others are shown of a new endpoint."""
        participant = self.participant
        return EndpointInfo(
            kind=EndpointKind.PUBLISHER if writer else EndpointKind.SUBSCRIPTION,
            topic=_ros_topic(endpoint.dds_topic),
            type=endpoint.type,
            gid=participant.new_gid(writer=writer),
            qos=endpoint.qos,
            transport=transport,
            participant=participant.guid,
            host=participant.host.id,
            node=participant.name,
            dds_topic=endpoint.dds_topic,
            user_data=endpoint.user_data,
        )

    def close(self) -> None:
        """End everything now; again is harmless."""
        if self.closed:
            return
        self.closed = True
        self._end()
        self.participant.domain.leave(self.participant)

    def crash(self) -> None:
        """End everything now without a word to the others."""
        if self.closed:
            return
        self.closed = True
        endpoints = list(self.participant.endpoints)
        self.participant.domain.crash(self.participant)
        for endpoint in endpoints:
            endpoint.silence()
        self._end()

    async def ended(self) -> None:
        """Return when the callbacks that `close` cancelled have ended."""
        tasks = self._tasks - {asyncio.current_task()}
        if tasks:
            await asyncio.wait(tasks)

    def _end(self) -> None:
        for thing in reversed(list(self._owned)):
            thing.close()
        self._owned.clear()
        if not self.loop.is_closed():
            self.graph.close()
            for task in self._tasks - {_current_task()}:
                task.cancel()


class _Bridge(LoopBridge):
    """A bridge without a far side: everything is on the loop already."""

    def post(self, function: Callable[[], None]) -> None:
        self.loop.call_soon(function)


class _FrameWriter(Writer):
    """Sends what `frame_service` made, which is no message of the topic's type."""

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        self.forward(cdr, source_timestamp_ns)


class _Mismatches:
    """The publishers that a reader's `MismatchWatch` is to hear of: only those that do not match."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def listen(self, listener: Callable[[EndpointEvent], None]) -> Callable[[], None]:
        watch = self._reader.suspicion = Watch(self._reader.participant, listener)
        return watch.end


def _raw(target: Target) -> RawEndpoint:
    return RawEndpoint(dds_topic=names.dds_topic(target.topic), type=target.type, qos=target.qos)


@cache
def _ros_topic(dds_topic: str) -> str:
    wire = names.ros_name_from_dds(dds_topic)
    return wire.name if wire is not None and wire.role is names.DdsRole.TOPIC else dds_topic


def _current_task() -> asyncio.Task[Any] | None:
    try:
        return asyncio.current_task()
    except RuntimeError:
        return None
