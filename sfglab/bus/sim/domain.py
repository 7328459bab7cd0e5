"""Hosts of a simulated world, and discovery in a domain: participants, and what each has discovered.

A participant keeps a list of its changes: endpoints that opened or closed. Each other participant has a view
of it, which reads the list in order when announcements arrive. A disconnected host stops the reading. After
the lease the view is lost, and the two participants discover each other again after the reconnection.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointInfo, EndpointKind, RawEndpoint, ros_topic
from sfglab.bus.sim.loop import NEVER_NS
from sfglab.bus.sim.settings import (
    ANNOUNCEMENT_SHARE,
    ENDPOINT_NS,
    LOOPBACK_NS,
    PARTICIPANT_NS,
    Costs,
    ns_from_s,
)
from sfglab.qos import Durability, History, QoSProfile, Reliability, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.graph import Graph
    from sfglab.bus.sim.loop import VirtualLoop

#: Number of one-way transfers until two participants have discovered each other: SPDP, its response and
#: heartbeat, a request, the data.
_CROSSINGS = 4


@dataclass(eq=False, slots=True)
class Host:
    """Host of the world, with a link to the network."""

    id: str  #: 16 hexadecimal digits, as `EndpointInfo.host` shows them.
    latency_ns: int  #: Latency of the link, ns.
    is_connected: bool = True  #: Whether the link carries packets; see `World.connect`.

    def can_reach(self, other: Host) -> bool:
        """Return whether packets reach a host from here."""
        return self is other or (self.is_connected and other.is_connected)

    def delay_ns(self, other: Host, far_ns: int) -> int:
        """Return the delay of a packet to a host, ns. To another host it is `far_ns` and the latency of both links."""
        return LOOPBACK_NS if self is other else self.latency_ns + other.latency_ns + far_ns


@dataclass(eq=False, slots=True)
class Process:
    """Process that does one work after the other."""

    free_ns: int = 0  #: Time at which all work so far is done, ns.

    def occupy(self, time_ns: int, duration_ns: int) -> int:
        """Add work that arrives at `time_ns` and runs after all earlier work; return the time of its end, ns."""
        self.free_ns = max(self.free_ns, time_ns) + duration_ns
        return self.free_ns


class Endpoint:
    """Writer or reader of one topic, which keeps its matching endpoints and calls `notify` on changes."""

    kind: EndpointKind

    def __init__(
        self, participant: Participant, endpoint: RawEndpoint, notify: Callable[[], None]
    ) -> None:
        qos = endpoint.qos
        self.participant = participant
        self.gid = participant.new_gid(self.kind)
        self.info = EndpointInfo(
            kind=self.kind,
            topic=ros_topic(endpoint.dds_topic),
            type=endpoint.type,
            gid=self.gid,
            qos=qos,
            transport=endpoint.transport,
            participant=participant.guid,
            host=participant.host.id,
            node=participant.name,
            dds_topic=endpoint.dds_topic,
            user_data=endpoint.user_data,
        )
        self.reliable = qos.reliability is Reliability.RELIABLE
        self.latched = qos.durability is Durability.TRANSIENT_LOCAL
        #: Depth of the history; None for all.
        self.depth = qos.depth if qos.history is History.KEEP_LAST else None
        #: Matching endpoints, each with the number of the latest sample received from it or sent to it.
        self.peers: dict[Any, int] = {}
        self.is_open = True
        self._ignores_own = endpoint.forwards
        self._notify = notify
        self._loop = participant.domain.loop

    @property
    def matched(self) -> int:
        """Number of matching endpoints."""
        return len(self.peers)

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """GUID prefixes of the participants of matching endpoints."""
        return frozenset(peer.gid[:12] for peer in self.peers)

    def suits(self, other: Endpoint) -> bool:
        """Return whether this endpoint and another one of the same topic match."""
        if self.kind is other.kind or self.info.transport != other.info.transport:
            return False
        ours = self.info
        theirs = other.info
        writer, reader = (ours, theirs) if self.kind is EndpointKind.PUBLISHER else (theirs, ours)
        if writer.type != reader.type or not _compatible(writer.qos, reader.qos):
            return False
        if self.participant is other.participant:
            return not (self._ignores_own or other._ignores_own)
        return ours.transport == "dds" or ours.host == theirs.host

    def close(self) -> None:
        """Retract the endpoint; repeated calls are harmless."""
        self.participant.withdraw(self)

    def silence(self) -> None:
        """Stop sending and receiving, without notice to others."""
        self.is_open = False
        self.peers.clear()

    def learn(self, endpoint: Any) -> None:
        """Add a matching endpoint; repeated calls are harmless."""
        raise NotImplementedError

    def forget(self, endpoint: Endpoint) -> None:
        """Remove an endpoint that has left; harmless if it is unknown."""
        if self.peers.pop(endpoint, None) is not None:
            self._notify()

    def repair(self, participant: Participant) -> None:
        """Send again what a participant has missed while it was disconnected."""


@cache
def _compatible(offered: QoSProfile, requested: QoSProfile) -> bool:
    return not incompatibilities(offered=offered, requested=requested)


class Participant:
    """Participant of a node in a domain: its endpoints, and those that it has discovered."""

    def __init__(  # noqa: PLR0913 - by keyword
        self,
        domain: Domain,
        host: Host,
        process: Process,
        graph: Graph,
        *,
        name: str,
        number: int,
        lease_ns: int,
    ) -> None:
        self.domain = domain
        self.host = host
        self.process = process  #: Process that runs the node.
        self.graph = graph  #: Graph that receives every discovered endpoint.
        self.name = name  #: Full name of the node.
        self.lease_ns = lease_ns  #: Lease, ns: the others remove a participant after this silence.
        digest = hashlib.blake2b(f"{host.id} {number} {name}".encode(), digest_size=12).digest()
        self.guid = digest + b"\x00\x00\x01\xc1"  # RTPS 2.5, table 9.1: ENTITYID_PARTICIPANT
        self.is_alive = True
        #: Endpoints that opened (True) or closed (False).
        self.changes: list[tuple[Endpoint, bool]] = []
        self.views: dict[Participant, View] = {}  #: Views of all participants, itself included.
        #: Endpoints of the participant by DDS topic.
        self.own: defaultdict[str, dict[Endpoint, None]] = defaultdict(dict)
        #: Discovered endpoints by DDS topic.
        self.known: defaultdict[str, dict[Endpoint, None]] = defaultdict(dict)
        self._serial = 0

    def new_gid(self, kind: EndpointKind) -> bytes:
        """Return the GUID of the next endpoint (RTPS 2.5, clause 9.3.1.2: user-defined, without a key)."""
        self._serial += 1
        entity_kind = b"\x03" if kind is EndpointKind.PUBLISHER else b"\x04"
        return self.guid[:12] + self._serial.to_bytes(3, "big") + entity_kind

    def open(self, endpoint: Endpoint) -> None:
        """Announce a new endpoint, and match it with discovered endpoints and the participant's own."""
        topic = endpoint.info.dds_topic
        known = self.known[topic] | self.own[topic]
        self.own[topic][endpoint] = None
        for other in known:
            if endpoint.suits(other):
                endpoint.learn(other)
        self.domain.announce(self, endpoint, is_open=True)

    def withdraw(self, endpoint: Endpoint) -> None:
        """Close an endpoint, and announce its end to the other participants; repeated calls are harmless."""
        if endpoint.is_open:
            del self.own[endpoint.info.dds_topic][endpoint]
            endpoint.silence()
            self.domain.announce(self, endpoint, is_open=False)

    def endpoints(self) -> list[Endpoint]:
        """Return the participant's own endpoints."""
        return [endpoint for endpoints in self.own.values() for endpoint in endpoints]

    def learn(self, endpoint: Endpoint) -> None:
        """Add a discovered endpoint, and match it with the participant's own."""
        topic = endpoint.info.dds_topic
        self.known[topic][endpoint] = None
        for own in tuple(self.own[topic]):
            if own.suits(endpoint):
                own.learn(endpoint)
        self.graph.apply([(endpoint.gid, endpoint.info)])

    def forget(self, endpoint: Endpoint) -> None:
        """Remove an endpoint of another participant that was closed, also from the participant's own matches."""
        topic = endpoint.info.dds_topic
        self.known[topic].pop(endpoint, None)
        for own in tuple(self.own[topic]):
            own.forget(endpoint)
        self.graph.apply([(endpoint.gid, None)])


class View:
    """View of the endpoints of one participant, the owner, by another one, the observer."""

    def __init__(self, observer: Participant, owner: Participant) -> None:
        self.met_ns = NEVER_NS  #: Time of their discovery, ns; NEVER_NS before it and after a loss.
        self._apart_ns = NEVER_NS  # time of their disconnection; NEVER_NS while they are connected
        self._observer = observer
        self._owner = owner
        self._loop = owner.domain.loop
        self._read = 0
        self._latest_ns = 0

    @property
    def is_apart(self) -> bool:
        """Whether the observer cannot reach the owner, because the host of one of them is disconnected."""
        return not self._owner.host.can_reach(self._observer.host)

    def expect(self, delay_ns: int) -> None:
        """Read the owner's changes so far after a delay, and not before the two have discovered each other."""
        if self.met_ns != NEVER_NS:
            time_ns = self._loop.now_ns + delay_ns
            self._latest_ns = max(self._latest_ns, time_ns, self.met_ns)
            self._loop.at(self._latest_ns, self._update, len(self._owner.changes))

    def check_cable(self) -> None:
        """Note that a host was disconnected or connected; the view is lost after a lease without connection."""
        now_ns = self._loop.now_ns
        if self.is_apart and self._apart_ns == NEVER_NS:
            self._apart_ns = now_ns
            self._loop.at(now_ns + self._owner.lease_ns, self._check_lease)
        elif not self.is_apart and self._apart_ns != NEVER_NS:
            self._apart_ns = NEVER_NS
            if not self._owner.is_alive:
                self._lose()
                return
            for endpoint in self._owner.endpoints():
                endpoint.repair(self._observer)
            self.expect(self._owner.host.delay_ns(self._observer.host, ENDPOINT_NS))

    def _check_lease(self) -> None:
        if self._loop.now_ns - self._apart_ns >= self._owner.lease_ns:
            self._lose()

    def _lose(self) -> None:
        """Remove all endpoints of the owner."""
        self.met_ns = NEVER_NS
        self._read = 0
        known = [end for ends in self._observer.known.values() for end in ends]
        for endpoint in known:
            if endpoint.participant is self._owner and self._observer.is_alive:
                self._observer.forget(endpoint)

    def _update(self, end: int) -> None:
        """Read the owner's changes up to an index; endpoints that have closed meanwhile are left out."""
        if self._loop.now_ns < self.met_ns or self.is_apart or not self._observer.is_alive:
            return
        for endpoint, is_open in self._owner.changes[self._read : end]:
            if not is_open:
                self._observer.forget(endpoint)
            elif endpoint.is_open:
                self._observer.learn(endpoint)
        self._read = max(self._read, end)


class Domain:
    """DDS domain of the whole network, or of one host's loopback interface."""

    def __init__(self, loop: VirtualLoop, costs: Costs) -> None:
        self.loop = loop
        self.costs = costs
        self.members: dict[Participant, None] = {}
        self.announced = 0  #: Number of endpoints announced so far.
        #: Work that occupies all processes at once, each of them for the whole time.
        self.backlog = Process()

    def join(self, newcomer: Participant) -> None:
        """Add a participant, and let it discover the others."""
        for other in self.members:
            other.views[newcomer] = View(other, newcomer)
            newcomer.views[other] = View(newcomer, other)
            self._meet(newcomer, other, 0)
        own = newcomer.views[newcomer] = View(newcomer, newcomer)
        own.met_ns = 0
        self.members[newcomer] = None

    def leave(self, participant: Participant) -> None:
        """Remove a participant, which retracts its endpoints first."""
        for endpoint in participant.endpoints():
            participant.withdraw(endpoint)
        participant.is_alive = False
        del self.members[participant]

    def announce(self, owner: Participant, endpoint: Endpoint, *, is_open: bool) -> None:
        """Announce an endpoint, or its end, to all members; this takes time of processes, see `Costs`."""
        costs = self.costs
        now_ns = self.loop.now_ns
        self.announced += is_open
        backlog_ns = 0
        if costs.endpoint_s:
            owner.process.occupy(now_ns, ns_from_s(costs.endpoint_s))
        if costs.announcement_s and len(self.members) > 1:
            backlog_ns = self.backlog.occupy(now_ns, ns_from_s(costs.announcement_s)) - now_ns
        owner.changes.append((endpoint, is_open))
        for other in self.members:
            delay_ns = backlog_ns + owner.host.delay_ns(other.host, ENDPOINT_NS)
            other.views[owner].expect(0 if other is owner else delay_ns)

    def check_cables(self) -> None:
        """Note that a host was disconnected or connected."""
        for member in self.members:
            for view in member.views.values():
                view.check_cable()
        for one, other in combinations(self.members, 2):
            views = one.views[other], other.views[one]
            if not views[0].is_apart and any(view.met_ns == NEVER_NS for view in views):
                lease_ns = min(one.lease_ns, other.lease_ns)
                self._meet(one, other, round(lease_ns * ANNOUNCEMENT_SHARE))

    def _meet(self, one: Participant, other: Participant, wait_ns: int) -> None:
        """Let two participants discover each other after `wait_ns`, the time until an announcement."""
        delay_ns = wait_ns + PARTICIPANT_NS
        if one.host is not other.host:
            delay_ns += _CROSSINGS * (one.host.latency_ns + other.host.latency_ns)
        for view in (one.views[other], other.views[one]):
            if view.is_apart:
                view.check_cable()
            elif view.met_ns == NEVER_NS:
                view.met_ns = self.loop.now_ns + delay_ns
                view.expect(delay_ns)
