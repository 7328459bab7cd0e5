"""Routing between an agent's domain and the global one: paper A, section 4.1, Eq. 1 and Table 1.

What crosses, and what of a topic's way has to be open for it, as pure functions: the one place that decides it,
for the in-process router (`sfglab.fleet.router.plan`) and for other routers' configurations.

A reader is opened in the source's domain when somebody subscribes in the target's; outward only if there is a
source too, so that only what is in use is announced in the global domain. Inward at once: so another agent's
router learns that somebody here wants the topic, and routers do not wait for each other. A writer is opened
when there is a source as well, also for one whose samples have to wait; where a router offers what it could
open, when there is a source, so that ROS 2's tools list it. What a source offers is offered across the border,
and nothing stronger is requested than a direct connection would have.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

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
        """The side across the border."""
        return Side.GLOBAL if self is Side.LOCAL else Side.LOCAL


class Direction(Enum):
    """Which way a sample crosses the border."""

    OUTWARD = "outward"  #: From the agent's domain into the global one.
    INWARD = "inward"  #: From the global domain into the agent's.

    @property
    def source(self) -> Side:
        """The side that a sample comes from."""
        return Side.LOCAL if self is Direction.OUTWARD else Side.GLOBAL

    @property
    def target(self) -> Side:
        """The side that a sample goes to."""
        return self.source.other


class Crossing(Enum):
    """How much of a ROS name, which may be several DDS topics, crosses."""

    NONE = "none"
    #: Only some of its DDS topics: a service whose requests pass and whose replies do not.
    PARTIAL = "partial"
    WHOLE = "whole"


@dataclass(frozen=True, slots=True, kw_only=True)
class ForwardRule:
    """One row of Table 1."""

    #: DDS topic names; ``*`` stands for any characters, slashes included, as in the DDS Router.
    pattern: str
    description: str = ""  #: For people.
    directions: frozenset[Direction] = frozenset(Direction)  #: The ways it is open.

    def matches(self, dds_name: str) -> bool:
        """Return whether a DDS topic name falls under this rule."""
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
    """The set F_forward of Eq. 1 as rules."""

    rules: tuple[ForwardRule, ...] = TABLE_1  #: What may cross; everything else stays where it is.

    def crosses(self, dds_name: str, direction: Direction) -> bool:
        """Return whether samples of a topic on the wire, as "rt/tf", cross the border this way."""
        return self.deciding(dds_name, direction) is not None

    def deciding(self, dds_name: str, direction: Direction) -> ForwardRule | None:
        """Return the rule that lets a topic on the wire cross this way; None: none does, and it stays."""
        found = (
            rule for rule in self.rules if direction in rule.directions and rule.matches(dds_name)
        )
        return next(found, None)

    def domains(self, dds_name: str, published_in: Side) -> frozenset[Side]:
        """Return where a topic on the wire is heard: Eq. 1, with both sides of "D_i <-> D_0" named."""
        way = Direction.OUTWARD if published_in is Side.LOCAL else Direction.INWARD
        return frozenset(Side) if self.crosses(dds_name, way) else frozenset({published_in})

    def crossing(self, name: str, kind: ResourceKind, direction: Direction) -> Crossing:
        """Return how much of an absolute ROS name crosses; a half-open service or action hangs its callers.

        The direction is a topic's; a service needs its requests and replies in both.

        Raises:
            FqnError: The name is not valid for its kind.
        """
        if kind is ResourceKind.TOPIC:
            passes = [self.crosses(dds, direction) for dds in dds_names(name, kind)]
        else:
            passes = [self.crosses(dds, way) for dds in dds_names(name, kind) for way in Direction]
        if all(passes):
            return Crossing.WHOLE
        return Crossing.PARTIAL if any(passes) else Crossing.NONE


#: What a router's reader and volatile writer keep at least; see `MAX_BACKLOG_BYTES`.
QUEUE_DEPTH = 256

_SERVICE_PREFIXES = ("rq/", "rr/")
_CALLS_KEPT = 1000  # as `sfglab.bus.ros.program` keeps


def requested_qos(dds_topic: str, source: QoSProfile, sinks: Iterable[QoSProfile]) -> QoSProfile:
    """Return what the router's reader of a source requests.

    RELIABLE only where the source offers it and somebody wants it, so that a best-effort subscription costs no
    retransmission. Latched samples always: who joins late across the border gets them from the router's writer.
    """
    latched = source.durability is Durability.TRANSIENT_LOCAL
    repaired = latched or any(sink.reliability is Reliability.RELIABLE for sink in sinks)
    everything = source.history is History.KEEP_ALL or dds_topic.startswith(_SERVICE_PREFIXES)
    return QoSProfile(
        reliability=source.reliability if repaired else Reliability.BEST_EFFORT,
        durability=source.durability,
        history=History.KEEP_ALL if everything else History.KEEP_LAST,
        depth=max(QUEUE_DEPTH, source.depth if latched and not everything else 1),
    )


def announced_qos(dds_topic: str, sinks: Iterable[QoSProfile]) -> QoSProfile:
    """Return what the router's reader requests while no source is known: the strongest of the subscriptions."""
    requests = tuple(sinks)
    reliable = any(sink.reliability is Reliability.RELIABLE for sink in requests)
    latched = any(sink.durability is Durability.TRANSIENT_LOCAL for sink in requests)
    strongest = QoSProfile(
        reliability=Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
    )
    return requested_qos(dds_topic, strongest, requests)


def offered_qos(dds_topic: str, source: QoSProfile) -> QoSProfile:
    """Return what the router's writer offers for a source: the same, but for a volatile history's depth.

    That is only the sender's own buffer; a shallow one would lose samples that the source's would have kept. Of
    calls it does not keep all: it would wait for one client that stands still, and with it all others.
    """
    if dds_topic.startswith(_SERVICE_PREFIXES):
        return replace(source, history=History.KEEP_LAST, depth=_CALLS_KEPT)
    if source.durability is Durability.VOLATILE and source.history is History.KEEP_LAST:
        return replace(source, depth=max(source.depth, QUEUE_DEPTH))
    return source


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Path:
    """The way of one topic across the border."""

    dds_topic: str  #: The topic on the wire.
    type: str  #: As `EndpointInfo.type` names it; endpoints of another type are another path.
    outward: bool  #: Whether it leads from the local domain to the global one.

    @property
    def direction(self) -> Direction:
        """Which way it leads."""
        return Direction.OUTWARD if self.outward else Direction.INWARD


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderSpec:
    """A reader of the router, in the source's domain."""

    path: Path  #: What for.
    qos: QoSProfile  #: What it requests.
    transport: Transport = "dds"  #: How its sources send.
    again: int = 0  #: Of which doubt it reads the sources anew; 0: it is the first.


@dataclass(frozen=True, slots=True, kw_only=True)
class WriterSpec:
    """A writer of the router, in the target's domain."""

    path: Path  #: What for.
    qos: QoSProfile  #: What it offers.
    #: The one source that it stands for, if that one's samples are latched: several in one writer would push
    #: each other out of its history, and stay when their source has gone; or if its life has a lease. Empty:
    #: all other sources that offer the same.
    source: bytes = b""
    transport: Transport = "dds"  #: How its subscriptions receive.
    again: int = 0  #: As its reader's.


class Held(Enum):
    """What is said of a source whose samples must neither pass yet nor be lost."""

    HELD = "held"


Verdict = WriterSpec | Held | None  #: Where a source's samples go; None: nowhere.


@dataclass(frozen=True, slots=True)
class Setup:
    """What of a path is to be open: readers, writers, and which source of a reader goes to which writer."""

    readers: tuple[ReaderSpec, ...] = ()
    writers: tuple[WriterSpec, ...] = ()
    judged: Mapping[ReaderSpec, Mapping[bytes, Verdict]] = field(default_factory=dict)


@dataclass(slots=True)
class PathState:
    """What is known about one path."""

    #: Publishers in the source's domain whose samples may cross, by gid.
    sources: dict[bytes, EndpointInfo] = field(default_factory=dict)
    #: Subscriptions in the target's domain that count, by gid.
    sinks: dict[bytes, EndpointInfo] = field(default_factory=dict)
    #: Publishers in the source's domain whose samples may not cross, by gid.
    barred: dict[bytes, EndpointInfo] = field(default_factory=dict)
    held: set[bytes] = field(default_factory=set)  #: Those of `sources` whose samples have to wait.
    doubts: int = 0  #: How often latched sources were doubted.
    #: Latched ones of `sources` that somebody seemed to succeed, and in which doubt. They are read anew: who
    #: lives sends its history again, and what is left of one that was killed is sent to nobody any more.
    doubted: dict[bytes, int] = field(default_factory=dict)
    setup: Setup = field(default_factory=Setup)  #: What is open now.

    def __contains__(self, gid: bytes) -> bool:
        return any(gid in part for part in (self.sources, self.sinks, self.barred))

    def __bool__(self) -> bool:
        return bool(self.sources or self.sinks or self.barred)

    def discard(self, gid: bytes) -> None:
        """Forget an endpoint; harmless for one that is not known."""
        for part in (self.sources, self.sinks, self.barred):
            part.pop(gid, None)
        self.held.discard(gid)
        self.doubted.pop(gid, None)

    def doubt(self, newcomer: EndpointInfo) -> None:
        """Doubt the latched sources of other participants that have a new publisher's host and node name."""
        self.doubts += 1
        who = newcomer.host, newcomer.node
        for gid, source in self.sources.items() if newcomer.node else ():
            latched = source.qos.durability is Durability.TRANSIENT_LOCAL
            if (
                latched
                and (source.host, source.node) == who
                and source.participant != newcomer.participant
            ):
                self.doubted[gid] = self.doubts


def wanted(path: Path, state: PathState, *, offers: bool = False) -> Setup:
    """Return what of a path has to be open; with `offers` also writers of topics that nobody wants."""
    sinks = [sink.qos for sink in state.sinks.values()]
    if not sinks or (path.outward and not state.sources):
        offered = offers and not path.dds_topic.startswith(_SERVICE_PREFIXES)
        return Setup(writers=_offered(path, state) if offered else ())
    if not state.sources:
        readers = {ReaderSpec(path=path, qos=announced_qos(path.dds_topic, sinks)): None}
        return Setup(tuple(readers), (), _judged(readers, {}, state))
    transport = _transport(path, {sink.transport for sink in state.sinks.values()})
    ways, alike = {}, {}
    for gid, source in sorted(state.sources.items()):
        kind = source.qos, source.transport, state.doubted.get(gid, 0)
        if kind not in alike:  # of one kind there may be hundreds
            alike[kind] = _way(path, sinks, transport, *kind)
        reader, writer = alike[kind]
        ways[gid] = reader, replace(writer, source=gid) if _is_alone(source) else writer
    readers = dict.fromkeys(reader for reader, _ in alike.values())
    writers = dict.fromkeys(writer for _, writer in ways.values())
    return Setup(tuple(readers), tuple(writers), _judged(readers, ways, state))


def _offered(path: Path, state: PathState) -> tuple[WriterSpec, ...]:
    """Return writers that show what there is: a volatile source's own, for latched samples another.

    For a latched writer's history of an earlier demand could not be taken back.
    """
    specs: dict[WriterSpec, None] = {}
    for gid, source in sorted(state.sources.items()):
        alone = _is_alone(source) and source.qos.durability is Durability.VOLATILE
        qos = offered_qos(path.dds_topic, source.qos)
        specs[WriterSpec(path=path, qos=qos, source=gid if alone else b"")] = None
    return tuple(specs)


def _transport(path: Path, sinks: set[Transport]) -> Transport:
    """Return how the subscriptions are reached: a request goes to one server, a reply to all."""
    if len(sinks) > 1 and path.dds_topic.startswith("rr/"):
        return "any"
    return "ros" if "ros" in sinks else "dds"


def _way(  # noqa: PLR0913, PLR0917 - what a reader and a writer are made of
    path: Path,
    sinks: Iterable[QoSProfile],
    to: Transport,
    qos: QoSProfile,
    of: Transport,
    again: int,
) -> tuple[ReaderSpec, WriterSpec]:
    reader = ReaderSpec(
        path=path, qos=requested_qos(path.dds_topic, qos, sinks), transport=of, again=again
    )
    return reader, WriterSpec(
        path=path, qos=offered_qos(path.dds_topic, qos), transport=to, again=again
    )


def _is_alone(source: EndpointInfo) -> bool:
    return source.qos.durability is Durability.TRANSIENT_LOCAL or source.qos.lease_ns is not None


def _judged(
    readers: Iterable[ReaderSpec],
    ways: Mapping[bytes, tuple[ReaderSpec, WriterSpec]],
    state: PathState,
) -> dict[ReaderSpec, dict[bytes, Verdict]]:
    """Say for every reader where each publisher's samples go: each source is heard by one reader alone."""
    judged: dict[ReaderSpec, dict[bytes, Verdict]] = {}
    for reader in readers:
        judged[reader] = verdicts = dict.fromkeys(state.barred)
        for gid, (own, writer) in ways.items():
            here = Held.HELD if gid in state.held else writer
            verdicts[gid] = here if own == reader else None
    return judged
