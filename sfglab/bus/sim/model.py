"""A simulated network's parts: hosts, domains, participants, topics and endpoints, and what each remembers.

Knows who belongs to whom and who matches. Refuses to know when anything happens.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from sfglab.bus.api import EndpointAdded, EndpointInfo, EndpointRemoved
from sfglab.bus.sim.loop import NEVER_NS, VirtualLoop
from sfglab.bus.sim.settings import Costs, LinkModel, ns_from_s
from sfglab.bus.sim.wire import Load
from sfglab.qos import Durability, History, QoSProfile, Reliability, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: A sample on its way: sequence number from 1, CDR, source time stamp (ns).
Item = tuple[int, bytes, int]


class Environment:
    """What all parts of one world share: its loop, its costs, its trace and its numbers."""

    def __init__(self, loop: VirtualLoop, costs: Costs) -> None:
        self.loop = loop
        self.costs = costs
        #: Told what happens ("join", "leave", "crash", "open", "close", "send", "take", "part" or "heal"), to
        #: whose gid, and the sample's CDR, the topic or the name; None is nobody.
        self.trace: Callable[[str, bytes, bytes], None] | None = None
        self._numbers = count()
        self._shapes: dict[tuple[str, str, QoSProfile], int] = {}
        self._compatible: dict[tuple[int, int], bool] = {}

    @property
    def now_ns(self) -> int:
        """The virtual time since the start, in nanoseconds."""
        return self.loop.now_ns

    def new_number(self) -> int:
        """Return a number that nothing else in this world has."""
        return next(self._numbers)

    def shape(self, type_: str, transport: str, qos: QoSProfile) -> int:
        """Return the number that stands for an endpoint's type, transport and QoS."""
        return self._shapes.setdefault((type_, transport, qos), len(self._shapes))

    def compatible(self, offered: int, requested: int) -> bool:
        """Return whether a writer of one shape and a reader of another can match."""
        found = self._compatible.get((offered, requested))
        if found is None:
            shapes = list(self._shapes)
            theirs, ours = shapes[offered], shapes[requested]
            found = theirs[:2] == ours[:2] and not incompatibilities(
                offered=theirs[2], requested=ours[2]
            )
            self._compatible[offered, requested] = found
        return found


@dataclass(eq=False, slots=True)
class Host:
    """A host of the world: a link to the network, and counters."""

    name: str  #: What it is called.
    link: LinkModel  #: Its link.
    id: str  #: 16 hexadecimal digits, as `EndpointInfo.host` shows them.
    latency_ns: int = 0  #: The link's latency.
    side: int = 0  #: Hosts of different sides do not hear each other.
    #: Bytes received, by `Load`; what an account has not settled yet is missing.
    rx: list[int] = field(default_factory=lambda: [0] * len(Load))
    tx: list[int] = field(default_factory=lambda: [0] * len(Load))  #: Bytes sent.
    rx_free_ns: int = 0  #: Until when the link is busy with what comes in.
    tx_free_ns: int = 0  #: The same for what goes out.

    def set_link(self, link: LinkModel) -> None:
        """Change the link."""
        self.link = link
        self.latency_ns = ns_from_s(link.latency_s)


def new_host(name: str, link: LinkModel, seed: int) -> Host:
    """Return a host whose id follows from the world's seed and its name."""
    host = Host(name, link, hashlib.blake2b(f"{seed} {name}".encode(), digest_size=8).hexdigest())
    host.set_link(link)
    return host


@dataclass(eq=False, slots=True)
class Process:
    """What does one thing after the other."""

    free_ns: int = 0  #: When it is done with all that it has heard so far.

    def occupy(self, now_ns: int, cost_ns: int) -> None:
        """Let it spend time on something that it hears now, behind what it has heard before."""
        self.free_ns = max(self.free_ns, now_ns) + cost_ns


@dataclass(eq=False, slots=True)
class Participant:
    """A node's place in a domain."""

    domain: Domain  #: Where it takes part.
    host: Host  #: Where it runs.
    process: Process  #: Who does its work.
    name: str  #: The node's full name.
    number: int  #: One that nothing else in the world has.
    user_data: bytes  #: Its USER_DATA.
    discovery_info: bool  #: Whether ROS 2's tools shall see its node, which takes one more writer.
    lease_ns: int  #: How long the others believe that it lives without a sign of it.
    interval_ns: int  #: Of its periodic announcements.
    guid: bytes = b""  #: Its 16-byte GUID.
    #: Of its host's link, when it joined; what discovery takes is settled by it.
    latency_ns: int = 0
    loss: float = 0.0  #: The same.
    born_ns: int = 0  #: When it joined.
    crashed_ns: int | None = None  #: When it fell silent without a word; None otherwise.
    left_ns: int | None = None  #: When it left; None otherwise.
    last_sent_ns: int = 0  #: When it last sent a sample, as a sign of life.
    ticked_ns: int = 0  #: Until when its periodic announcements are accounted.
    #: Until when a heartbeat of its built-in writers covers what is new: of readers, of writers.
    heartbeat_until_ns: list[int] = field(default_factory=lambda: [0, 0])
    endpoints: dict[Endpoint, None] = field(default_factory=dict)  #: What it has.
    _serial: int = 0

    def __post_init__(self) -> None:
        prefix = hashlib.blake2b(
            f"{self.host.id} {self.number} {self.name}".encode(), digest_size=12
        ).digest()
        self.guid = prefix + b"\x00\x00\x01\xc1"  # RTPS 2.5, table 9.1: ENTITYID_PARTICIPANT
        self.latency_ns = self.host.latency_ns
        self.loss = self.host.link.loss

    @property
    def alive(self) -> bool:
        """Whether it still takes part."""
        return self.crashed_ns is None and self.left_ns is None

    def new_gid(self, *, writer: bool) -> bytes:
        """Return the GUID of the next endpoint (RTPS 2.5, clause 9.3.1.2: user-defined, without a key)."""
        self._serial += 1
        return self.guid[:12] + self._serial.to_bytes(3, "big") + (b"\x03" if writer else b"\x04")


@dataclass(eq=False, slots=True)
class Partition:
    """A time in which the network falls into sides that do not hear each other."""

    start_ns: int  #: From when on.
    sides: dict[Host, int]  #: The number of each host's side; 0 of those that are not named.
    end_ns: int = NEVER_NS  #: Until when; `NEVER_NS` while it lasts.

    @property
    def lasts(self) -> bool:
        """Whether it has not ended."""
        return self.end_ns == NEVER_NS

    def separates(self, one: Participant, other: Participant) -> bool:
        """Return whether two participants are on different sides."""
        return self.sides.get(one.host, 0) != self.sides.get(other.host, 0)


class Observer(Protocol):
    """Whoever is to be told of endpoints."""

    @property
    def participant(self) -> Participant:
        """Whose view counts."""

    def learn(self, endpoint: Endpoint) -> None:
        """Take note of an endpoint; again is harmless."""

    def forget(self, endpoint: Endpoint) -> None:
        """Take note that it has gone; harmless if it was never known."""


@dataclass(eq=False, slots=True)
class Topic:
    """The endpoints of one DDS topic, and who watches them."""

    writers: dict[Endpoint, None] = field(default_factory=dict)  #: In the order of their creation.
    readers: dict[Endpoint, None] = field(default_factory=dict)  #: The same.
    fading: dict[Endpoint, None] = field(default_factory=dict)  #: Retracted, but not for everybody.
    #: Watches of readers, and of writers.
    watches: tuple[dict[Observer, None], dict[Observer, None]] = field(
        default_factory=lambda: ({}, {})
    )

    def endpoints(self) -> Iterator[Endpoint]:
        """Yield all that somebody may know of."""
        yield from self.writers
        yield from self.readers
        yield from self.fading

    def same_kind(self, endpoint: Endpoint) -> dict[Endpoint, None]:
        """Return the index that an endpoint belongs to."""
        return self.writers if endpoint.is_writer else self.readers

    def counterparts(self, endpoint: Endpoint) -> dict[Endpoint, None]:
        """Return the index of what an endpoint may match."""
        return self.readers if endpoint.is_writer else self.writers


@dataclass(eq=False, slots=True)
class Domain:
    """One DDS domain: of the whole network, or of one host's loopback interface."""

    environment: Environment  #: Of the world.
    networked: bool  #: Whether it spans hosts.
    members: dict[Participant, None] = field(default_factory=dict)  #: Who takes part.
    topics: dict[str, Topic] = field(default_factory=dict)  #: By their DDS names.
    graphs: dict[Observer, None] = field(default_factory=dict)  #: Those that somebody listens to.
    #: Stands for all its processes: what all of them hear occupies each of them for as long.
    crowd: Process = field(default_factory=Process)
    announced: int = 0  #: How many endpoints it has had so far.

    def topic(self, dds_topic: str) -> Topic:
        """Return a DDS topic's index."""
        topic = self.topics.get(dds_topic)
        if topic is None:
            topic = self.topics[dds_topic] = Topic()
        return topic

    def endpoints(self) -> Iterator[Endpoint]:
        """Yield all endpoints that somebody may know of."""
        for topic in self.topics.values():
            yield from topic.endpoints()


class Endpoint:
    """A writer or reader of one topic: whom it matches, told by `notify`, and how the others hear of it."""

    __slots__ = (
        "_added",
        "_environment",
        "_ignores_own",
        "_loop",
        "_notify",
        "backlog_ns",
        "born_ns",
        "depth",
        "gid",
        "gone_ns",
        "info",
        "is_open",
        "latched",
        "lifespan_ns",
        "number",
        "participant",
        "peers",
        "reliable",
        "sequence",
        "shape",
        "suspicion",
        "topic",
        "withdraw",
    )

    is_writer: ClassVar[bool]

    def __init__(
        self,
        participant: Participant,
        info: EndpointInfo,
        notify: Callable[[], None],
        *,
        ignores_own: bool = False,
    ) -> None:
        environment, qos = participant.domain.environment, info.qos
        self.participant = participant
        self.info = info
        self.gid = info.gid
        self.topic = participant.domain.topic(info.dds_topic)
        self.number = environment.new_number()  #: One that nothing else in the world has.
        #: Stands for its type, transport and QoS; equal ones, equal number.
        self.shape = environment.shape(info.type, info.transport, qos)
        self.reliable = qos.reliability is Reliability.RELIABLE
        self.latched = qos.durability is Durability.TRANSIENT_LOCAL
        self.depth = qos.depth if qos.history is History.KEEP_LAST else None  #: None is all.
        #: After how long a writer's samples expire; None is never.
        self.lifespan_ns = qos.lifespan_ns
        self.sequence = 0  #: The number of a writer's latest sample.
        self.born_ns = 0  #: When it was announced.
        self.gone_ns: int | None = None  #: When it was retracted; None until then.
        self.backlog_ns = 0  #: How long the others take until they have time for its announcement.
        #: Hears of what does not match; None when nobody cares.
        self.suspicion: Observer | None = None
        #: What matches now; of a reader, with the latest sample's number.
        self.peers: dict[Any, int] = {}
        self.is_open = True
        self.withdraw: Callable[[Endpoint], None] | None = None  #: How its domain lets it go.
        self._ignores_own = ignores_own
        self._notify = notify
        self._environment = environment
        self._loop = environment.loop
        self._added: EndpointAdded | None = None

    @property
    def added(self) -> EndpointAdded:
        """The event of its appearance, one for all who hear of it."""
        if self._added is None:
            self._added = EndpointAdded(endpoint=self.info)
        return self._added

    @property
    def removed(self) -> EndpointRemoved:
        """The event of its end."""
        return EndpointRemoved(endpoint=self.info)

    @property
    def fades(self) -> bool:
        """Whether it is retracted, or its owner has fallen silent, so that others cease to know it."""
        return self.gone_ns is not None or self.participant.crashed_ns is not None

    @property
    def matched(self) -> int:
        """How many endpoints match now."""
        return len(self.peers)

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """The GUID prefixes of the participants of what matches now."""
        return frozenset(peer.gid[:12] for peer in self.peers)

    def suits(self, other: Endpoint) -> bool:
        """Return whether this and an endpoint of the other kind on the same topic match."""
        if self.is_writer:
            fits = self._environment.compatible(self.shape, other.shape)
        else:
            fits = self._environment.compatible(other.shape, self.shape)
        if not fits:
            return False
        owner, their_owner = self.participant, other.participant
        if owner is their_owner:
            return not (self._ignores_own or other._ignores_own)
        return self.info.transport == "dds" or owner.host is their_owner.host

    def close(self) -> None:
        """Retract it; again is harmless."""
        if self.is_open and self.withdraw is not None:
            self.withdraw(self)

    def silence(self) -> None:
        """Let it neither send nor take anything more, without a word to the others."""
        self.is_open = False
        self.peers.clear()

    def settle(self) -> None:
        """Bring the accounts of what others owe it up to date."""

    def reroute(self) -> None:
        """Look again how samples get to the others."""

    def learn(self, endpoint: Endpoint) -> None:
        """Take note of an endpoint that matches; again is harmless."""
        raise NotImplementedError

    def forget(self, endpoint: Endpoint) -> None:
        """Take note that it has gone; harmless if it was never known."""
        if self.peers.pop(endpoint, None) is not None:
            self._notify()
