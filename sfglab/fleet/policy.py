"""Routing between an agent's domain and the global one: paper A, section 4.1, Eq. 1 and Table 1.

Functions without side effects decide which topics are forwarded and which readers and writers have to be open, for
sfglab's router (`sfglab.fleet.router.plan`) and for the configurations of other routers.

*Readers.* A reader is opened in the source's domain when the target's domain has a subscription. Outward, the router
also requires a source, so that only used topics are announced in the global domain. Inward, the router requires no
source: another agent's router then discovers the demand, and routers do not wait for each other. Readers request
nothing stronger than a direct connection would have.

*Writers.* A writer is opened when there is a subscription and a source, including a source whose samples have to wait.
A router that advertises topics opens a writer for a source alone, so that ROS 2's tools list the topic. Writers offer
the QoS of their source.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from fnmatch import fnmatchcase
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from sfglab.names import ResourceKind, dds_names
from sfglab.qos import Durability, History, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab.bus.api import EndpointInfo, Transport


class Side(Enum):
    """One of the two domains that a router joins."""

    LOCAL = "local"  #: The agent's own domain, D_i in the paper.
    GLOBAL = "global"  #: The domain that all agents share, D_0 in the paper.

    @property
    def other(self) -> Side:
        """The opposite side of the domain boundary."""
        return Side.GLOBAL if self is Side.LOCAL else Side.LOCAL


class Direction(Enum):
    """Direction of a sample across the domain boundary."""

    OUTWARD = "outward"  #: Agent's domain to global domain.
    INWARD = "inward"  #: Global domain to agent's domain.

    @property
    def source(self) -> Side:
        """Side of the publisher."""
        return Side.LOCAL if self is Direction.OUTWARD else Side.GLOBAL

    @property
    def target(self) -> Side:
        """Side of the subscription."""
        return self.source.other


class Crossing(Enum):
    """How many of the DDS topics of a ROS name are forwarded: all, some or none."""

    NONE = "none"
    #: Some of the DDS topics are forwarded, such as the requests of a service without its replies.
    PARTIAL = "partial"
    WHOLE = "whole"


@dataclass(frozen=True, slots=True, kw_only=True)
class ForwardRule:
    """One row of Table 1 in paper A: a pattern of DDS topics that are forwarded."""

    #: DDS topic names; ``*`` stands for any characters, slashes included, as in the DDS Router.
    pattern: str
    description: str = ""  #: Description for people.
    #: Directions in which topics of the rule are forwarded.
    directions: frozenset[Direction] = frozenset(Direction)

    def matches(self, dds_name: str) -> bool:
        """Return whether a DDS topic matches this rule."""
        return fnmatchcase(dds_name, self.pattern)


TABLE_1 = (
    ForwardRule(pattern="rt/tf", description="Transform topic"),
    ForwardRule(pattern="rt/tf_static", description="Static transform topic"),
    ForwardRule(pattern="rt/global/*", description="Global topics"),
    ForwardRule(pattern="rq/global/*", description="Global service requests"),
    ForwardRule(pattern="rr/global/*", description="Global service responses"),
)
"""Paper A, Table 1: everything that crosses D_i <-> D_0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Policy:
    """The set F_forward of Eq. 1 in paper A, as rules."""

    rules: tuple[ForwardRule, ...] = TABLE_1  #: Rules; topics that match none do not cross.

    def crosses(self, dds_name: str, direction: Direction) -> bool:
        """Return whether samples of a DDS topic, as "rt/tf", cross in a direction."""
        return self.deciding(dds_name, direction) is not None

    def deciding(self, dds_name: str, direction: Direction) -> ForwardRule | None:
        """Return the rule that forwards a DDS topic in a direction, or None."""
        for rule in self.rules:
            if direction in rule.directions and rule.matches(dds_name):
                return rule
        return None

    def domains(self, dds_name: str, published_in: Side) -> frozenset[Side]:
        """Return the sides on which a DDS topic is received: Eq. 1, with both sides of "D_i <-> D_0"."""
        direction = Direction.OUTWARD if published_in is Side.LOCAL else Direction.INWARD
        return frozenset(Side) if self.crosses(dds_name, direction) else frozenset({published_in})

    def crossing(self, name: str, kind: ResourceKind, direction: Direction) -> Crossing:
        """Return how much of a ROS name is forwarded; clients of a partly forwarded service wait indefinitely.

        The direction is a topic's; a service needs its requests and replies in both.

        Raises:
            FqnError: The name is not valid for its kind.
        """
        ways = (direction,) if kind is ResourceKind.TOPIC else tuple(Direction)
        passes = [self.crosses(dds, way) for dds in dds_names(name, kind) for way in ways]
        if all(passes):
            return Crossing.WHOLE
        return Crossing.PARTIAL if any(passes) else Crossing.NONE


#: Minimum depth of a router's readers and volatile writers; see `MAX_BACKLOG_BYTES`.
QUEUE_DEPTH = 256

_SERVICE_PREFIXES = ("rq/", "rr/")
_CALLS_KEPT = 1000  # as `sfglab.bus.ros.program` keeps


def requested_qos(dds_topic: str, source: QoSProfile, sinks: Iterable[QoSProfile]) -> QoSProfile:
    """Return the QoS of the router's reader of a source.

    The reader is RELIABLE only if the source offers and a subscription requests RELIABLE, so that best-effort
    subscriptions cost no retransmission. The reader of latched samples is always RELIABLE, because late joiners get
    these samples from the router's writer.
    """
    latched = _is_latched(source)
    repaired = latched or any(sink.reliability is Reliability.RELIABLE for sink in sinks)
    everything = source.history is History.KEEP_ALL or dds_topic.startswith(_SERVICE_PREFIXES)
    return QoSProfile(
        reliability=source.reliability if repaired else Reliability.BEST_EFFORT,
        durability=source.durability,
        history=History.KEEP_ALL if everything else History.KEEP_LAST,
        depth=max(QUEUE_DEPTH, source.depth if latched and not everything else 1),
    )


def announced_qos(dds_topic: str, sinks: Iterable[QoSProfile]) -> QoSProfile:
    """Return the QoS of the router's reader without a source: the strongest of the subscriptions."""
    requests = tuple(sinks)
    reliable = any(sink.reliability is Reliability.RELIABLE for sink in requests)
    latched = any(_is_latched(sink) for sink in requests)
    strongest = QoSProfile(
        reliability=Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
    )
    return requested_qos(dds_topic, strongest, requests)


def offered_qos(dds_topic: str, source: QoSProfile) -> QoSProfile:
    """Return the QoS of the router's writer for a source: the same except for the depth.

    A volatile history is only the sender's buffer, and a shallow buffer would lose samples that the source's buffer
    keeps. A writer of requests or replies does not have KEEP_ALL, because one stalled client would then block it for
    all others.
    """
    if dds_topic.startswith(_SERVICE_PREFIXES):
        return replace(source, history=History.KEEP_LAST, depth=_CALLS_KEPT)
    if source.durability is Durability.VOLATILE and source.history is History.KEEP_LAST:
        return replace(source, depth=max(source.depth, QUEUE_DEPTH))
    return source


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Path:
    """Path of one topic across the domain boundary."""

    dds_topic: str  #: DDS topic.
    type: str  #: Type as in `EndpointInfo.type`; endpoints of another type have another path.
    outward: bool  #: Whether the path leads from the agent's domain to the global one.

    @property
    def direction(self) -> Direction:
        """Direction of the path."""
        return Direction.OUTWARD if self.outward else Direction.INWARD


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderSpec:
    """A reader of the router, in the source's domain."""

    path: Path  #: Path that the reader belongs to.
    qos: QoSProfile  #: Requested QoS.
    transport: Transport = "dds"  #: Transport of the sources.
    #: Generation in which the sources are read again; 0 for the first reader.
    reread_generation: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class WriterSpec:
    """A writer of the router, in the target's domain."""

    path: Path  #: Path that the writer belongs to.
    qos: QoSProfile  #: Offered QoS.
    #: GID of the writer's only source, if that source is latched or has a liveliness lease; empty for all other
    #: sources that offer the same QoS. Several latched sources would overwrite each other's samples in the history of
    #: one writer, and their samples would remain after their end.
    source: bytes = b""
    transport: Transport = "dds"  #: Transport to the subscriptions.
    reread_generation: int = 0  #: Generation of the reader (`ReaderSpec`).


class Held(Enum):
    """Destination that holds the samples of a source without loss until they may pass."""

    HELD = "held"


Destination = WriterSpec | Held | None  #: Destination of a source's samples; None to drop them.


@dataclass(frozen=True, slots=True)
class Setup:
    """Readers and writers of a path that have to be open, and the destination of each reader's sources."""

    readers: tuple[ReaderSpec, ...] = ()
    writers: tuple[WriterSpec, ...] = ()
    routes: Mapping[ReaderSpec, Mapping[bytes, Destination]] = field(default_factory=dict)


@dataclass(slots=True)
class PathState:
    """Endpoints of one path by GID, and the path's current setup."""

    #: Publishers in the source's domain whose samples may cross.
    sources: dict[bytes, EndpointInfo] = field(default_factory=dict)
    #: Subscriptions in the target's domain that count.
    sinks: dict[bytes, EndpointInfo] = field(default_factory=dict)
    #: Publishers in the source's domain whose samples may not cross.
    blocked_publishers: dict[bytes, EndpointInfo] = field(default_factory=dict)
    held: set[bytes] = field(default_factory=set)  #: Sources whose samples have to wait.
    #: Number of new publishers so far, each of which may succeed a latched source.
    generation: int = 0
    #: Latched sources that a new publisher may succeed, with its generation. They are read again: a source that
    #: is alive sends its history again, and the rest of a killed source is sent to no late joiner.
    possibly_stale: dict[bytes, int] = field(default_factory=dict)
    setup: Setup = field(default_factory=Setup)  #: Current setup.

    def __contains__(self, gid: bytes) -> bool:
        return any(gid in part for part in (self.sources, self.sinks, self.blocked_publishers))

    def __bool__(self) -> bool:
        return bool(self.sources or self.sinks or self.blocked_publishers)

    def discard(self, gid: bytes) -> None:
        """Forget an endpoint; unknown endpoints are ignored."""
        for part in (self.sources, self.sinks, self.blocked_publishers):
            part.pop(gid, None)
        self.held.discard(gid)
        self.possibly_stale.pop(gid, None)

    def mark_possibly_stale(self, newcomer: EndpointInfo) -> None:
        """Mark latched sources of other participants that have a new publisher's host and node name."""
        self.generation += 1
        if not newcomer.node:
            return
        for gid, source in self.sources.items():
            is_namesake = (source.host, source.node) == (newcomer.host, newcomer.node)
            is_other = source.participant != newcomer.participant
            if _is_latched(source.qos) and is_namesake and is_other:
                self.possibly_stale[gid] = self.generation


class SourceKind(NamedTuple):
    """Properties of a source on which its reader and writer depend; hundreds of sources may share them."""

    qos: QoSProfile
    transport: Transport
    reread_generation: int


def wanted(path: Path, state: PathState, *, advertise_unused: bool = False) -> Setup:
    """Return the setup of a path; with `advertise_unused` there are writers without a subscription."""
    sinks = [sink.qos for sink in state.sinks.values()]
    if not sinks or (path.outward and not state.sources):
        if advertise_unused and not path.dds_topic.startswith(_SERVICE_PREFIXES):
            return Setup(writers=_advertised(path, state))
        return Setup()
    if not state.sources:
        reader = ReaderSpec(path=path, qos=announced_qos(path.dds_topic, sinks))
        return Setup((reader,), (), _routes([reader], {}, state))
    to = _transport(path, {sink.transport for sink in state.sinks.values()})

    @cache
    def specs_of(kind: SourceKind) -> tuple[ReaderSpec, WriterSpec]:
        generation = kind.reread_generation
        reader = ReaderSpec(
            path=path,
            qos=requested_qos(path.dds_topic, kind.qos, sinks),
            transport=kind.transport,
            reread_generation=generation,
        )
        writer = WriterSpec(
            path=path,
            qos=offered_qos(path.dds_topic, kind.qos),
            transport=to,
            reread_generation=generation,
        )
        return reader, writer

    specs: dict[bytes, tuple[ReaderSpec, WriterSpec]] = {}
    for gid, source in sorted(state.sources.items()):
        kind = SourceKind(source.qos, source.transport, state.possibly_stale.get(gid, 0))
        reader, writer = specs_of(kind)
        if _needs_own_writer(source.qos):
            writer = replace(writer, source=gid)
        specs[gid] = reader, writer
    readers = dict.fromkeys(reader for reader, _ in specs.values())
    writers = dict.fromkeys(writer for _, writer in specs.values())
    return Setup(tuple(readers), tuple(writers), _routes(readers, specs, state))


def _advertised(path: Path, state: PathState) -> tuple[WriterSpec, ...]:
    """Return writers that advertise sources: a volatile source's own writer, for latched sources another one.

    The history of a latched source's own writer, from an earlier demand, could not be taken back.
    """
    specs: dict[WriterSpec, None] = {}
    for gid, source in sorted(state.sources.items()):
        is_own = _needs_own_writer(source.qos) and not _is_latched(source.qos)
        qos = offered_qos(path.dds_topic, source.qos)
        specs[WriterSpec(path=path, qos=qos, source=gid if is_own else b"")] = None
    return tuple(specs)


def _transport(path: Path, sinks: set[Transport]) -> Transport:
    """Return the transport to the subscriptions: a request goes to one server, a reply to all."""
    if len(sinks) > 1 and path.dds_topic.startswith("rr/"):
        return "any"
    return "ros" if "ros" in sinks else "dds"


def _is_latched(qos: QoSProfile) -> bool:
    return qos.durability is Durability.TRANSIENT_LOCAL


def _needs_own_writer(qos: QoSProfile) -> bool:
    return _is_latched(qos) or qos.lease_ns is not None


def _routes(
    readers: Iterable[ReaderSpec],
    specs: Mapping[bytes, tuple[ReaderSpec, WriterSpec]],
    state: PathState,
) -> dict[ReaderSpec, dict[bytes, Destination]]:
    """Return every publisher's destination per reader: only one reader forwards a source's samples."""
    routes: dict[ReaderSpec, dict[bytes, Destination]] = {}
    for reader in readers:
        destinations: dict[bytes, Destination] = dict.fromkeys(state.blocked_publishers)
        for gid, (own, writer) in specs.items():
            destinations[gid] = None
            if own == reader:
                destinations[gid] = Held.HELD if gid in state.held else writer
        routes[reader] = destinations
    return routes
