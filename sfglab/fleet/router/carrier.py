"""Open paths of a router: forwards and outlets, and which endpoints of the global domain it has to hear of.

Knows what is open; refuses to know why (`plan`).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import (
    EndpointAdded,
    EndpointKind,
    EndpointRemoved,
    RawEndpoint,
    entries,
    user_data,
)
from sfglab.bus.errors import BusError
from sfglab.bus.forwarding import ForwardCounts
from sfglab.fleet.policy import Direction, ReaderSpec, WriterSpec
from sfglab.fleet.router.frames import TF_TYPE
from sfglab.fleet.router.plan import ROUTER_KEY, Close, Forget, Judge, Open
from sfglab.names import TF, TF_STATIC, dds_topic
from sfglab.qos import Durability, Liveliness

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from sfglab.bus import EndpointEvent, EndpointInfo, Graph, Node
    from sfglab.bus.forwarding import Forward, RawWriter, Transform
    from sfglab.fleet.policy import Path, Side
    from sfglab.fleet.router.frames import TransformGate
    from sfglab.fleet.router.plan import Action


_OTHER = {
    EndpointKind.PUBLISHER: EndpointKind.SUBSCRIPTION,
    EndpointKind.SUBSCRIPTION: EndpointKind.PUBLISHER,
}
_Topic = tuple[str, EndpointKind]


@dataclass(slots=True)
class _Watch:
    end: Callable[[], None]
    here: set[bytes] = field(default_factory=set)
    there: dict[bytes, EndpointInfo] = field(default_factory=dict)


class Interest:
    """Watches in the domain of a graph the counterparts of what another domain has.

    `hear` is given what happens to counterparts, and that they have gone when nothing meets them any more.
    """

    def __init__(self, graph: Graph, hear: Callable[[EndpointEvent], None]) -> None:
        self._graph = graph
        self._hear = hear
        self._watches: dict[_Topic, _Watch] = {}

    def feed(self, event: EndpointEvent) -> None:
        """Take an event of the other domain: an endpoint whose counterparts matter, or do not any more."""
        endpoint = event.endpoint
        topic = (endpoint.dds_topic, _OTHER[endpoint.kind])
        if isinstance(event, EndpointAdded):
            self._watch(topic).here.add(endpoint.gid)
        elif (watch := self._watches.get(topic)) is not None:
            watch.here.discard(endpoint.gid)
            if not watch.here:
                self._forget(topic, watch)

    def close(self) -> None:
        """Watch nothing any more; again is harmless."""
        for watch in self._watches.values():
            watch.end()
        self._watches.clear()

    def _watch(self, topic: _Topic) -> _Watch:
        if topic not in self._watches:
            watch = self._watches[topic] = _Watch(end=lambda: None)
            watch.end = self._graph.watch(*topic, partial(self._heard, topic))
        return self._watches[topic]

    def _heard(self, topic: _Topic, event: EndpointEvent) -> None:
        if (watch := self._watches.get(topic)) is None:
            return
        if isinstance(event, EndpointAdded):
            watch.there[event.endpoint.gid] = event.endpoint
        else:
            watch.there.pop(event.endpoint.gid, None)
        self._hear(event)

    def _forget(self, topic: _Topic, watch: _Watch) -> None:
        del self._watches[topic]
        watch.end()
        for endpoint in watch.there.values():
            self._hear(EndpointRemoved(endpoint=endpoint))


_log = logging.getLogger(__name__)
_TF_TOPICS = frozenset({dds_topic(TF), dds_topic(TF_STATIC)})


@dataclass(frozen=True, slots=True, kw_only=True)
class PathStatus:
    """One path that is open."""

    topic: str  #: The topic on the wire.
    type: str  #: Its type.
    direction: str  #: "outward" or "inward".
    readers: int  #: How many readers the router has for it.
    writers: int  #: How many writers.
    forwarded: int  #: Samples forwarded since it was opened.
    dropped: int  #: Samples not forwarded.
    bytes: int  #: CDR forwarded, in bytes.


@dataclass(slots=True)
class _OpenPath:
    readers: dict[ReaderSpec, Forward[Any, Any]] = field(default_factory=dict)
    writers: dict[WriterSpec, RawWriter] = field(default_factory=dict)
    #: What readers did that were replaced.
    past: ForwardCounts = field(default_factory=ForwardCounts)

    def retire(self, counts: ForwardCounts) -> None:
        self.past.forwarded += counts.forwarded
        self.past.dropped += counts.dropped
        self.past.bytes += counts.bytes

    def status(self, path: Path) -> PathStatus:
        counts = [self.past, *(forward.counts for forward in self.readers.values())]
        return PathStatus(
            topic=path.dds_topic,
            type=path.type,
            direction=path.direction.value,
            readers=len(self.readers),
            writers=len(self.writers),
            forwarded=sum(c.forwarded for c in counts),
            dropped=sum(c.dropped for c in counts),
            bytes=sum(c.bytes for c in counts),
        )


class Carrier:
    """The open half of a router, whose endpoints' USER_DATA names a pair of domains; without a gate if None."""

    def __init__(
        self, nodes: Mapping[Side, Node], *, pair: str, gate: TransformGate | None
    ) -> None:
        self._tag = user_data({ROUTER_KEY: pair})
        self._gate = gate
        self._forwarders = {
            way: nodes[way.source].open_forwarder(nodes[way.target]) for way in Direction
        }
        self._open: dict[Path, _OpenPath] = {}
        self._owners: dict[ReaderSpec, dict[bytes, str]] = {}
        self._judged: dict[ReaderSpec, dict[bytes, Judge]] = {}  # of readers of others' transforms

    @property
    def paths(self) -> tuple[PathStatus, ...]:
        """All open paths, sorted by topic, type and direction."""
        return tuple(self._open[path].status(path) for path in sorted(self._open))

    def carry_out(self, actions: list[Action]) -> None:
        """Do what a plan says, in its order."""
        for action in actions:
            match action:
                case Open(what=ReaderSpec() | WriterSpec() as spec):
                    self._open_one(spec)
                case Close(what=ReaderSpec() | WriterSpec() as spec):
                    self._close(spec)
                case Judge():
                    self._judge(action)
                case Forget(reader=reader, source=gid):
                    self._forget(reader, gid)

    def close(self) -> None:
        """Close everything."""
        for opened in self._open.values():
            for forward in opened.readers.values():
                forward.close()
            for writer in opened.writers.values():
                writer.close()
        self._open.clear()

    def _open_one(self, spec: ReaderSpec | WriterSpec) -> None:
        path = spec.path
        forwarder = self._forwarders[path.direction]
        topic, tag = path.dds_topic, self._tag
        endpoint = RawEndpoint(
            dds_topic=topic, type=path.type, qos=spec.qos, user_data=tag, transport=spec.transport
        )
        opened = self._open.setdefault(path, _OpenPath())
        try:
            if isinstance(spec, ReaderSpec):
                opened.readers[spec] = forwarder.open(endpoint)
            else:
                if (
                    spec.qos.liveliness is Liveliness.MANUAL_BY_TOPIC
                    and spec.qos.lease_ns is not None
                ):
                    _log.warning(
                        "%s: life that is asserted without a message does not cross", path.dds_topic
                    )
                opened.writers[spec] = forwarder.open_writer(endpoint)
        except BusError:
            # A topic that cannot be served must not end the others.
            _log.exception("%s %s cannot be forwarded", path.direction.value, path.dds_topic)

    def _close(self, spec: ReaderSpec | WriterSpec) -> None:
        opened = self._open[spec.path]
        if isinstance(spec, WriterSpec):
            if (writer := opened.writers.pop(spec, None)) is not None:
                writer.close()
        elif (forward := opened.readers.pop(spec, None)) is not None:
            forward.close()
            opened.retire(forward.counts)
            self._judged.pop(spec, None)
            self._let_go(self._owners.pop(spec, {}))
        if not opened.readers and not opened.writers:
            del self._open[spec.path]

    def _judge(self, judge: Judge) -> None:
        reader, source, writer = judge.reader, judge.source, judge.writer
        opened = self._open[reader.path]
        if (
            self._gate is not None
            and reader.path.dds_topic in _TF_TOPICS
            and not reader.path.outward
        ):
            self._judged.setdefault(reader, {})[source.gid] = judge
        if (forward := opened.readers.get(reader)) is None:
            return
        outlet = None if writer is None else opened.writers.get(writer)
        if outlet is None:
            forward.refuse(source.gid)
        else:
            forward.admit(source.gid, outlet, self._transform(reader, source))

    def _forget(self, reader: ReaderSpec, gid: bytes) -> None:
        if (forward := self._open[reader.path].readers.get(reader)) is not None:
            forward.forget(gid)
        self._judged.get(reader, {}).pop(gid, None)
        if (owner := self._owners.get(reader, {}).pop(gid, None)) is not None:
            self._let_go({gid: owner})

    def _let_go(self, gone: Mapping[bytes, str]) -> None:
        """Let others move the frames of those who no longer publish transforms."""
        if gone and self._gate is not None:
            kept = (owner for owners in self._owners.values() for owner in owners.values())
            if self._gate.keep_owners(frozenset(kept)):
                for reader in [
                    r for r in self._judged if r.qos.durability is Durability.TRANSIENT_LOCAL
                ]:
                    self._read_again(reader)

    def _read_again(self, reader: ReaderSpec) -> None:
        """Read a latched history anew: what was refused for another's sake is not sent again by itself."""
        opened = self._open[reader.path]
        if (forward := opened.readers.pop(reader, None)) is not None:
            forward.close()
            opened.retire(forward.counts)
            self._open_one(reader)
            for judge in list(self._judged[reader].values()):
                self._judge(judge)

    def _transform(self, reader: ReaderSpec, source: EndpointInfo) -> Transform | None:
        """Return what is done with a source's samples on their way; None: nothing."""
        path = reader.path
        if self._gate is None or path.dds_topic not in _TF_TOPICS or path.type != TF_TYPE:
            return None
        if path.outward:
            return self._gate.outward
        owner = entries(source.user_data).get(ROUTER_KEY) or source.participant.hex()
        self._owners.setdefault(reader, {})[source.gid] = owner
        return self._gate.inward(owner)
