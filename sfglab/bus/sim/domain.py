"""Discovery in a simulated domain: participants, and the endpoints that each of them has discovered.

A participant keeps a list of its changes: endpoints that opened or closed. Each other participant has a view
of it, which reads the list in order when announcements arrive. A disconnected host stops the reading. After
the lease the view is lost, and the two participants discover each other again after the reconnection.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from functools import cache
from itertools import combinations
from typing import TYPE_CHECKING, Any

from sfglab.bus.sim.loop import NEVER_NS
from sfglab.bus.sim.network import Host, Network, Server
from sfglab.bus.sim.settings import (
    ANNOUNCEMENT_SHARE,
    ENDPOINT_NS,
    LOOPBACK_NS,
    PARTICIPANT_NS,
    REPAIR_NS,
    ns_from_s,
)
from sfglab.qos import Durability, History, QoSProfile, Reliability, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import EndpointInfo
    from sfglab.bus.graph import Graph

#: Number of one-way transfers until two participants have discovered each other: SPDP, its response and
#: heartbeat, a request, the data.
_CROSSINGS = 4


class Endpoint:
    """Writer or reader of one topic, which keeps its matching endpoints and calls `notify` on changes."""

    is_writer: bool

    def __init__(
        self,
        participant: Participant,
        info: EndpointInfo,
        notify: Callable[[], None],
        *,
        ignores_own: bool = False,
    ) -> None:
        qos = info.qos
        self.participant = participant
        self.info = info
        self.gid = info.gid
        self.reliable = qos.reliability is Reliability.RELIABLE
        self.latched = qos.durability is Durability.TRANSIENT_LOCAL
        #: Depth of the history; None for all.
        self.depth = qos.depth if qos.history is History.KEEP_LAST else None
        #: Matching endpoints; a reader keeps the number of each writer's latest sample.
        self.peers: dict[Any, int] = {}
        self.is_open = True
        self._ignores_own = ignores_own
        self._notify = notify
        self._network = participant.domain.network
        self._loop = self._network.loop

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
        ours, theirs = self.info, other.info
        if self.is_writer is other.is_writer or ours.transport != theirs.transport:
            return False
        writer, reader = (ours, theirs) if self.is_writer else (theirs, ours)
        if writer.type != reader.type or not _compatible(writer.qos, reader.qos):
            return False
        owner, their_owner = self.participant, other.participant
        if owner is their_owner:
            return not (self._ignores_own or other._ignores_own)
        return ours.transport == "dds" or owner.host is their_owner.host

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


@cache
def _compatible(offered: QoSProfile, requested: QoSProfile) -> bool:
    return not incompatibilities(offered=offered, requested=requested)


class Participant:
    """Participant of a node in a domain: its endpoints, and those that it has discovered."""

    def __init__(  # noqa: PLR0913 - by keyword
        self,
        domain: Domain,
        host: Host,
        process: Server,
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
        self.lease_ns = lease_ns  #: Lease: the others remove a participant after this silence.
        self.interval_ns = round(lease_ns * ANNOUNCEMENT_SHARE)  #: Period of its announcements.
        digest = hashlib.blake2b(f"{host.id} {number} {name}".encode(), digest_size=12).digest()
        self.guid = digest + b"\x00\x00\x01\xc1"  # RTPS 2.5, table 9.1: ENTITYID_PARTICIPANT
        self.born_ns = domain.network.loop.now_ns
        self.crashed_ns = NEVER_NS
        self.last_sent_ns = 0  #: Time of its latest sample.
        self.is_alive = True
        #: Endpoints that opened (True) or closed (False).
        self.changes: list[tuple[Endpoint, bool]] = []
        self.views: dict[Participant, View] = {}  #: Views of all participants, itself included.
        #: Its endpoints by DDS topic.
        self.own: defaultdict[str, dict[Endpoint, None]] = defaultdict(dict)
        #: Discovered endpoints by DDS topic.
        self.known: defaultdict[str, dict[Endpoint, None]] = defaultdict(dict)
        self._serial = 0

    def new_gid(self, *, writer: bool) -> bytes:
        """Return the GUID of the next endpoint (RTPS 2.5, clause 9.3.1.2: user-defined, without a key)."""
        self._serial += 1
        return self.guid[:12] + self._serial.to_bytes(3, "big") + (b"\x03" if writer else b"\x04")

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
        """Retract an endpoint; repeated calls are harmless."""
        if self.own[endpoint.info.dds_topic].pop(endpoint, endpoint) is None:
            endpoint.silence()
            if self.is_alive:
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
        """Remove an endpoint that has left."""
        topic = endpoint.info.dds_topic
        self.known[topic].pop(endpoint, None)
        for own in tuple(self.own[topic]):
            own.forget(endpoint)
        self.graph.apply([(endpoint.gid, None)])

    def lease_end_ns(self) -> int:
        """Return the virtual time, ns, at which others remove the participant if it falls silent now."""
        now_ns = self.domain.network.loop.now_ns
        announced_ns = now_ns - (now_ns - self.born_ns) % self.interval_ns
        return max(announced_ns, self.last_sent_ns) + self.lease_ns


class View:
    """View of the endpoints of one participant, the owner, by another one, the observer."""

    def __init__(self, observer: Participant, owner: Participant) -> None:
        self.met_ns = NEVER_NS  #: Time of their discovery; NEVER_NS before it and after a loss.
        #: Time at which the two were disconnected; NEVER_NS while they are connected.
        self.apart_ns = NEVER_NS
        self._observer = observer
        self._owner = owner
        self._loop = owner.domain.network.loop
        self._known: dict[Endpoint, None] = {}
        self._read = 0
        self._latest_ns = 0

    @property
    def is_apart(self) -> bool:
        """Whether a disconnected host separates the two."""
        return not self._owner.host.can_reach(self._observer.host)

    def expect(self, delay_ns: int) -> None:
        """Read the owner's changes so far after a delay, and not before the two have discovered each other."""
        if self.met_ns != NEVER_NS:
            time_ns = self._loop.now_ns + delay_ns
            self._latest_ns = max(self._latest_ns, time_ns, self.met_ns)
            self._loop.at(self._latest_ns, self._update, len(self._owner.changes))

    def lose(self) -> None:
        """Remove all endpoints of the owner, because its lease has expired; repeated calls are harmless."""
        self.met_ns = NEVER_NS
        self._read = 0
        while self._known and self._observer.is_alive:
            self._observer.forget(self._known.popitem()[0])

    def check_cable(self) -> None:
        """Note that a host was disconnected or connected; the view is lost after a lease without connection."""
        now_ns = self._loop.now_ns
        if self.is_apart and self.apart_ns == NEVER_NS:
            self.apart_ns = now_ns
            self._loop.at(now_ns + self._owner.lease_ns, self._check_lease)
        elif not self.is_apart and self.apart_ns != NEVER_NS:
            self.apart_ns = NEVER_NS
            if self._owner.is_alive:
                self.expect(REPAIR_NS)

    def _check_lease(self) -> None:
        if self._loop.now_ns - self.apart_ns >= self._owner.lease_ns:
            self.lose()

    def _update(self, end: int) -> None:
        """Read the owner's changes up to an index; endpoints that opened and closed in between are left out."""
        is_early = self._loop.now_ns < self.met_ns or self._owner.crashed_ns < self.met_ns
        if is_early or self.is_apart or not self._observer.is_alive:
            return
        changes: dict[Endpoint, bool] = {}
        for endpoint, is_open in self._owner.changes[self._read : end]:
            if is_open:
                changes[endpoint] = True
            elif not changes.pop(endpoint, False):
                changes[endpoint] = False
        self._read = max(self._read, end)
        for endpoint, is_open in changes.items():
            if is_open:
                self._known[endpoint] = None
                self._observer.learn(endpoint)
            else:
                self._known.pop(endpoint, None)
                self._observer.forget(endpoint)


class Domain:
    """DDS domain of the whole network, or of one host's loopback interface."""

    def __init__(self, network: Network) -> None:
        self.network = network
        self.members: dict[Participant, None] = {}
        self.announced = 0  #: Number of endpoints announced so far.
        #: Work that occupies all processes at once, each of them for the whole time.
        self.backlog = Server()

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
        self._drop(participant, is_silent=False)

    def crash(self, participant: Participant) -> None:
        """Let a participant fall silent; others notice it when its lease expires."""
        participant.crashed_ns = self.network.loop.now_ns
        self._drop(participant, is_silent=True)
        for endpoint in participant.endpoints():
            endpoint.silence()

    def announce(self, owner: Participant, endpoint: Endpoint, *, is_open: bool) -> None:
        """Announce an endpoint, or its end, to all members; this takes time of processes, see `Costs`."""
        costs, now_ns = self.network.costs, self.network.loop.now_ns
        self.announced += is_open
        backlog_ns = 0
        if costs.endpoint_s:
            owner.process.occupy(now_ns, ns_from_s(costs.endpoint_s))
        if costs.announcement_s and len(self.members) > 1:
            backlog_ns = self.backlog.occupy(now_ns, ns_from_s(costs.announcement_s)) - now_ns
        owner.changes.append((endpoint, is_open))
        for other in self.members:
            delay_ns = 0 if other is owner else backlog_ns + self._news_ns(owner, other)
            other.views[owner].expect(delay_ns)

    def check_cables(self) -> None:
        """Note that a host was disconnected or connected."""
        for member in self.members:
            for view in member.views.values():
                view.check_cable()
        for one, other in combinations(self.members, 2):
            views = one.views[other], other.views[one]
            if not views[0].is_apart and any(view.met_ns == NEVER_NS for view in views):
                now_ns = self.network.loop.now_ns
                waits_ns = [-(now_ns - p.born_ns) % p.interval_ns for p in (one, other)]
                self._meet(one, other, min(waits_ns))

    def _drop(self, participant: Participant, *, is_silent: bool) -> None:
        """Remove a member; members that it cannot notify remove it when its lease expires."""
        participant.is_alive = False
        del self.members[participant]
        for other in self.members:
            view = other.views[participant]
            if is_silent or view.is_apart:
                self.network.loop.at(participant.lease_end_ns(), view.lose)

    def _meet(self, one: Participant, other: Participant, wait_ns: int) -> None:
        """Let two participants discover each other; the next SPDP of either replaces a lost one."""
        delay_ns = wait_ns + PARTICIPANT_NS
        if one.host is not other.host:
            delay_ns += _CROSSINGS * (one.host.latency_ns + other.host.latency_ns)
            delay_ns += self.network.losses(one.host, other.host) * one.interval_ns // 2
        for view in (one.views[other], other.views[one]):
            if view.is_apart:
                view.check_cable()
            elif view.met_ns == NEVER_NS:
                view.met_ns = self.network.loop.now_ns + delay_ns
                view.expect(delay_ns)

    def _news_ns(self, owner: Participant, other: Participant) -> int:
        """Return the delay of an endpoint's announcement, ns; SEDP is reliable, so a loss is a delay."""
        if owner.host is other.host:
            return LOOPBACK_NS
        links_ns = owner.host.latency_ns + other.host.latency_ns
        repairs_ns = self.network.losses(owner.host, other.host) * REPAIR_NS
        return links_ns + ENDPOINT_NS + repairs_ns
