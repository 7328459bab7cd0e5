"""Discovery in a simulated domain: who joins, leaves and falls silent, and who is told of which endpoint, when.

An announcement costs what it concerns: endpoints and watches of its topic, and graphs that somebody listens to.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.bus.sim.settings import ns_from_s
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.bus.api import Listener
    from sfglab.bus.sim.accounts import Accounts
    from sfglab.bus.sim.model import Domain, Endpoint, Observer, Participant
    from sfglab.bus.sim.network import Network
    from sfglab.bus.sim.views import Views

_LOOK_AGAIN_NS = NS_PER_S  #: Looks of a partitioned world for who believes in what is retracted.


class Watch:
    """Tells a listener of the endpoints of one kind on one topic, in a participant's view."""

    def __init__(self, participant: Participant, tell: Listener) -> None:
        self.participant = participant
        self._tell: Listener | None = tell
        self._known: dict[Endpoint, None] = {}

    def learn(self, endpoint: Endpoint) -> None:
        """Tell of an endpoint that is new."""
        if self._tell is not None and endpoint not in self._known:
            self._known[endpoint] = None
            self._tell(endpoint.added)

    def forget(self, endpoint: Endpoint) -> None:
        """Tell of an endpoint that has gone."""
        if self._tell is not None and endpoint in self._known:
            del self._known[endpoint]
            self._tell(endpoint.removed)

    def end(self) -> None:
        """Tell nothing more."""
        self._tell = None
        self._known.clear()


class Discovery:
    """What makes the participants of a domain, and their endpoints, known to each other."""

    def __init__(self, domain: Domain, accounts: Accounts, views: Views, network: Network) -> None:
        self.domain = domain
        self.accounts = accounts
        self.views = views
        self._network = network
        self._environment = domain.environment
        self._loop = domain.environment.loop

    def join(self, participant: Participant) -> None:
        """Let a participant in."""
        participant.born_ns = participant.ticked_ns = self._loop.now_ns
        self._note("join", participant)
        self.accounts.joined(participant)
        self.domain.members[participant] = None

    def leave(self, participant: Participant) -> None:
        """Let a participant go that says so: what it has is retracted."""
        for endpoint in list(participant.endpoints):
            self._retract(endpoint)
        participant.left_ns = self._loop.now_ns
        self._note("leave", participant)
        self.accounts.left(participant)
        del self.domain.members[participant]

    def crash(self, participant: Participant) -> None:
        """Let a participant fall silent; the others notice when its lease runs out."""
        participant.crashed_ns = self._loop.now_ns
        self._note("crash", participant)
        self.accounts.crashed(participant)
        del self.domain.members[participant]
        end_ns = self.views.lease_end_ns(participant, participant.crashed_ns)
        self._loop.at(end_ns, self._expire, participant)

    def watch(self, watch: Watch, dds_topic: str, *, writers: bool) -> Callable[[], None]:
        """Let a watch see one kind of endpoint of a topic, those known now at once; return what ends it."""
        topic = self.domain.topic(dds_topic)
        topic.watches[writers][watch] = None
        self.show(watch, [e for e in topic.endpoints() if e.is_writer is writers])

        def end() -> None:
            watch.end()
            topic.watches[writers].pop(watch, None)

        return end

    def show(self, observer: Observer, endpoints: Iterable[Endpoint]) -> None:
        """Let an observer see endpoints: those known now at once, the others when the news arrives."""
        participant, now_ns = observer.participant, self._loop.now_ns
        for endpoint in endpoints:
            if self.views.knows(participant, endpoint):
                observer.learn(endpoint)
            for time_ns in self.views.turns_ns(participant, endpoint):
                if time_ns > now_ns:
                    self._loop.at(time_ns, self._look, endpoint, [observer])

    def open(self, endpoint: Endpoint) -> None:
        """Make a new endpoint known, and let it see whom it has to do with."""
        if self._environment.trace is not None:
            self._environment.trace("open", endpoint.gid, endpoint.info.dds_topic.encode())
        endpoint.withdraw = self._withdraw
        endpoint.born_ns = self._loop.now_ns
        self.domain.announced += 1
        self._charge(endpoint)
        endpoint.participant.endpoints[endpoint] = None
        topic = endpoint.topic
        peers, observers = self._concerned(endpoint)
        topic.same_kind(endpoint)[endpoint] = None
        self._schedule(endpoint, observers)
        self.show(endpoint, peers)
        self.accounts.announced(endpoint)

    def suspect(self, reader: Endpoint, listener: Listener) -> Callable[[], None]:
        """Tell a listener of the writers that do not match a reader; return what ends that."""
        watch = reader.suspicion = Watch(reader.participant, listener)
        self.show(watch, [writer for writer in reader.topic.writers if not reader.suits(writer)])
        return watch.end

    def _withdraw(self, endpoint: Endpoint) -> None:
        if self._environment.trace is not None:
            self._environment.trace("close", endpoint.gid, b"")
        endpoint.silence()
        self._retract(endpoint)

    def _retract(self, endpoint: Endpoint) -> None:
        """Make known that an endpoint has gone; again is harmless."""
        participant = endpoint.participant
        if endpoint not in participant.endpoints or not participant.alive:
            return
        del participant.endpoints[endpoint]
        endpoint.gone_ns = self._loop.now_ns
        self._charge(endpoint)
        topic = endpoint.topic
        del topic.same_kind(endpoint)[endpoint]
        last_ns = self._schedule(endpoint, self._concerned(endpoint)[1])
        topic.fading[endpoint] = None
        self._loop.at(
            max(last_ns, endpoint.gone_ns + self._network.slowest_ns), self._fade, endpoint
        )
        self.accounts.retracted(endpoint)

    def review(self, participant: Participant, other: Participant) -> None:
        """Let a participant's observers look again at all that another one has."""
        for endpoint in [e for e in self.domain.endpoints() if e.participant is other]:
            observers = [o for o in self._concerned(endpoint)[1] if o.participant is participant]
            self._look(endpoint, observers)
            self._schedule(endpoint, observers)

    def _concerned(self, endpoint: Endpoint) -> tuple[list[Endpoint], list[Observer]]:
        """Return what an endpoint matches, and who is to be told of it."""
        topic = endpoint.topic
        peers = []
        observers: list[Observer] = []
        for other in topic.counterparts(endpoint):
            if endpoint.suits(other):
                peers.append(other)
            elif other.suspicion is not None:
                observers.append(other.suspicion)
        return peers, [*peers, *observers, *topic.watches[endpoint.is_writer], *self.domain.graphs]

    def _schedule(self, endpoint: Endpoint, observers: list[Observer]) -> int:
        """Let observers look whenever their view of an endpoint may change; return when the last one does."""
        groups: dict[int, list[Observer]] = {}
        for observer in observers:
            for time_ns in self.views.turns_ns(observer.participant, endpoint):
                groups.setdefault(time_ns, []).append(observer)
        for time_ns, group in groups.items():
            self._loop.at(time_ns, self._look, endpoint, group)
        return max(groups, default=self._loop.now_ns)

    def _look(self, endpoint: Endpoint, observers: list[Observer]) -> None:
        if not endpoint.fades and not self.views.partitions:
            for observer in observers:  # nothing can have happened but that the news has arrived
                observer.learn(endpoint)
            return
        for observer in observers:
            if self.views.knows(observer.participant, endpoint):
                observer.learn(endpoint)
            else:
                observer.forget(endpoint)

    def _fade(self, endpoint: Endpoint) -> None:
        """Drop a retracted endpoint when nobody can know it any more."""
        if self.views.partitions:
            if any(self.views.knows(member, endpoint) for member in self.domain.members):
                self._loop.at(self._loop.now_ns + _LOOK_AGAIN_NS, self._fade, endpoint)
                return
            self._look(
                endpoint, self._concerned(endpoint)[1]
            )  # a view may have changed at this very instant
        del endpoint.topic.fading[endpoint]

    def _expire(self, participant: Participant) -> None:
        for endpoint in list(participant.endpoints):
            del endpoint.topic.same_kind(endpoint)[endpoint]
            self._look(endpoint, self._concerned(endpoint)[1])
        participant.endpoints.clear()

    def _note(self, what: str, participant: Participant) -> None:
        if self._environment.trace is not None:
            self._environment.trace(what, participant.guid, participant.name.encode())

    def settle(self) -> None:
        """Bring the accounts up to date."""
        self.accounts.settle()
        for topic in self.domain.topics.values():
            for writer in topic.writers:
                writer.settle()

    def _charge(self, endpoint: Endpoint) -> None:
        """Let an announcement, or retraction, take the time that it costs its maker and everybody."""
        now_ns, costs = self._loop.now_ns, self._environment.costs
        if costs.endpoint_s:
            endpoint.participant.process.occupy(now_ns, ns_from_s(costs.endpoint_s))
        if costs.announcement_s and len(self.domain.members) > 1:
            self.domain.crowd.occupy(now_ns, ns_from_s(costs.announcement_s))
            endpoint.backlog_ns = self.domain.crowd.free_ns - now_ns
