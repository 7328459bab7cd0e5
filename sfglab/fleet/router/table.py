"""Open paths of a router, and the endpoints of the global domain that it has to discover.

The table knows which paths are open; `plan` decides which paths must be open.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import (
    EndpointAdded,
    EndpointKind,
    EndpointRemoved,
    RawEndpoint,
    entries,
    ros_topic,
    user_data,
)
from sfglab.bus.errors import BusError
from sfglab.fleet.policy import Direction, ReaderSpec, WriterSpec
from sfglab.fleet.router.frames import TF_TYPE
from sfglab.fleet.router.plan import ROUTER_KEY, AssignRoute, Close, Open, RemoveSource
from sfglab.names import TF, TF_STATIC, dds_topic
from sfglab.qos import Durability, Liveliness

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from sfglab.bus import EndpointEvent, EndpointInfo, Graph, Node
    from sfglab.bus.forwarding import Forward, GuardedWriter, Transform
    from sfglab.fleet.policy import Side
    from sfglab.fleet.router.frames import TransformGate
    from sfglab.fleet.router.plan import Action

_log = logging.getLogger(__name__)
_TF_TOPICS = frozenset({dds_topic(TF), dds_topic(TF_STATIC)})
_OTHER = {
    EndpointKind.PUBLISHER: EndpointKind.SUBSCRIPTION,
    EndpointKind.SUBSCRIPTION: EndpointKind.PUBLISHER,
}
_Topic = tuple[str, EndpointKind]


class CounterpartWatcher:
    """Watches, in the domain of a graph, the counterparts of another domain's endpoints.

    `on_event` is called with events of counterparts, and with their removal when the last endpoint that they
    are counterparts of has gone.
    """

    def __init__(self, graph: Graph, on_event: Callable[[EndpointEvent], None]) -> None:
        self._graph = graph
        self._on_event = on_event
        self._here: dict[_Topic, set[bytes]] = {}  # endpoints of the other domain
        self._ends: dict[_Topic, Callable[[], None]] = {}

    def feed(self, event: EndpointEvent) -> None:
        """Process an event of the other domain: begin or end the watch for counterparts of an endpoint."""
        endpoint = event.endpoint
        topic = (endpoint.dds_topic, _OTHER[endpoint.kind])
        if isinstance(event, EndpointAdded):
            self._here.setdefault(topic, set()).add(endpoint.gid)
            if topic not in self._ends:
                self._ends[topic] = self._graph.watch(*topic, self._on_event)
        elif topic in self._here:
            self._here[topic].discard(endpoint.gid)
            if not self._here[topic]:
                self._forget(topic)

    def close(self) -> None:
        """End all watches; further calls have no effect."""
        for end in self._ends.values():
            end()
        self._here.clear()
        self._ends.clear()

    def _forget(self, topic: _Topic) -> None:
        del self._here[topic]
        self._ends.pop(topic)()
        dds_topic, kind = topic
        is_publisher = kind is EndpointKind.PUBLISHER
        known = self._graph.publishers if is_publisher else self._graph.subscriptions
        for endpoint in known(ros_topic(dds_topic)):
            self._on_event(EndpointRemoved(endpoint=endpoint))


@dataclass(frozen=True, slots=True, kw_only=True)
class PathStatus:
    """One open path of a router, as in its status reports."""

    topic: str  #: DDS topic.
    type: str  #: Type of the path's samples.
    direction: str  #: "outward" or "inward".
    readers: int  #: Number of the router's readers.
    writers: int  #: Number of the router's writers.


class ForwardingTable:
    """Open paths of a router.

    Args:
        nodes: The router's node in each domain.
        tag: Name of the agent's domain, in USER_DATA of the router's endpoints.
        gate: Checks and renames transforms; None forwards them unchanged.
    """

    def __init__(self, nodes: Mapping[Side, Node], *, tag: str, gate: TransformGate | None) -> None:
        self._user_data = user_data({ROUTER_KEY: tag})
        self._gate = gate
        self._forwarders = {
            direction: nodes[direction.source].open_forwarder(nodes[direction.target])
            for direction in Direction
        }
        self._readers: dict[ReaderSpec, Forward[Any, Any]] = {}
        self._writers: dict[WriterSpec, GuardedWriter] = {}
        # Publishers of transforms by reader and source, and the routes of readers of other agents' transforms.
        self._owners: dict[ReaderSpec, dict[bytes, str]] = {}
        self._routes: dict[ReaderSpec, dict[bytes, AssignRoute]] = {}

    @property
    def paths(self) -> tuple[PathStatus, ...]:
        """All open paths, sorted by topic, type and direction."""
        readers = Counter(spec.path for spec in self._readers)
        writers = Counter(spec.path for spec in self._writers)
        return tuple(
            PathStatus(
                topic=path.dds_topic,
                type=path.type,
                direction=path.direction.value,
                readers=readers[path],
                writers=writers[path],
            )
            for path in sorted(readers.keys() | writers.keys())
        )

    def apply(self, actions: Iterable[Action]) -> None:
        """Carry out the actions of a plan in their order."""
        for action in actions:
            match action:
                case Open(what=ReaderSpec() | WriterSpec() as spec):
                    self._open_one(spec)
                case Close(what=ReaderSpec() | WriterSpec() as spec):
                    self._close(spec)
                case AssignRoute():
                    self._assign(action)
                case RemoveSource(reader=reader, source=gid):
                    self._remove_source(reader, gid)

    def close(self) -> None:
        """Close all paths."""
        for forward in self._readers.values():
            forward.close()
        for writer in self._writers.values():
            writer.close()
        self._readers.clear()
        self._writers.clear()

    def _open_one(self, spec: ReaderSpec | WriterSpec) -> None:
        path, qos = spec.path, spec.qos
        forwarder = self._forwarders[path.direction]
        endpoint = RawEndpoint(
            dds_topic=path.dds_topic,
            type=path.type,
            qos=qos,
            user_data=self._user_data,
            transport=spec.transport,
        )
        try:
            if isinstance(spec, ReaderSpec):
                self._readers[spec] = forwarder.open(endpoint)
                return
            if qos.liveliness is Liveliness.MANUAL_BY_TOPIC and qos.lease_ns is not None:
                _log.warning(
                    "%s: MANUAL_BY_TOPIC liveliness assertions are not forwarded; only samples renew it",
                    path.dds_topic,
                )
            self._writers[spec] = forwarder.open_writer(endpoint)
        except BusError:
            # A topic that cannot be served must not end the others.
            _log.exception("%s %s cannot be forwarded", path.direction.value, path.dds_topic)

    def _close(self, spec: ReaderSpec | WriterSpec) -> None:
        if isinstance(spec, WriterSpec):
            if (writer := self._writers.pop(spec, None)) is not None:
                writer.close()
        elif (forward := self._readers.pop(spec, None)) is not None:
            forward.close()
            self._routes.pop(spec, None)
            self._release_frames(self._owners.pop(spec, {}))

    def _assign(self, route: AssignRoute) -> None:
        reader, source = route.reader, route.source
        is_tf = reader.path.dds_topic in _TF_TOPICS
        if self._gate is not None and is_tf and not reader.path.outward:
            self._routes.setdefault(reader, {})[source.gid] = route
        if (forward := self._readers.get(reader)) is None:
            return
        writer = None if route.writer is None else self._writers.get(route.writer)
        if writer is None:
            forward.refuse(source.gid)
        else:
            forward.admit(source.gid, writer, self._transform(reader, source))

    def _remove_source(self, reader: ReaderSpec, gid: bytes) -> None:
        if (forward := self._readers.get(reader)) is not None:
            forward.forget(gid)
        self._routes.get(reader, {}).pop(gid, None)
        if (owner := self._owners.get(reader, {}).pop(gid, None)) is not None:
            self._release_frames({gid: owner})

    def _release_frames(self, gone: Mapping[bytes, str]) -> None:
        """Let other publishers move the frames of publishers that have gone."""
        if not gone or self._gate is None:
            return
        remaining = set[str]()
        for owners in self._owners.values():
            remaining.update(owners.values())
        if self._gate.keep_owners(frozenset(remaining)):
            for reader in list(self._routes):
                if reader.qos.durability is Durability.TRANSIENT_LOCAL:
                    self._read_again(reader)

    def _read_again(self, reader: ReaderSpec) -> None:
        """Read latched transforms again: those that were refused because of another publisher are not repeated."""
        if (forward := self._readers.pop(reader, None)) is not None:
            forward.close()
            self._open_one(reader)
            for route in list(self._routes[reader].values()):
                self._assign(route)

    def _transform(self, reader: ReaderSpec, source: EndpointInfo) -> Transform | None:
        """Return the function that a source's samples pass through; None for none."""
        path = reader.path
        if self._gate is None or path.dds_topic not in _TF_TOPICS or path.type != TF_TYPE:
            return None
        if path.outward:
            return self._gate.outward
        owner = entries(source.user_data).get(ROUTER_KEY) or source.participant.hex()
        self._owners.setdefault(reader, {})[source.gid] = owner
        return self._gate.inward(owner)
