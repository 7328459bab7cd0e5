"""A DDS domain in the world: its participants and their endpoints, and who is told of what.

Indices by topic and grouping by time keep the cost of an announcement to those whom it concerns: endpoints of
the topic, watches of it, and graphs that somebody listens to. `views` decides who knows what.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from sfglab.bus.sim.accounts import Accounts
from sfglab.bus.sim.participant import Process

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from sfglab.bus.api import EndpointEvent
    from sfglab.bus.sim.endpoint import Endpoint
    from sfglab.bus.sim.participant import Participant
    from sfglab.bus.sim.reader import Reader
    from sfglab.bus.sim.world import World
    from sfglab.bus.sim.writer import Writer


_LOOK_AGAIN_NS = 1_000_000_000
"""How often a partitioned world looks whether somebody still believes in an endpoint that is retracted."""


class Observer(Protocol):
    """Whoever is to be told of endpoints."""

    @property
    def participant(self) -> Participant:
        """Whose view counts."""

    def learn(self, endpoint: Endpoint) -> None:
        """Take note of an endpoint; again is harmless."""

    def forget(self, endpoint: Endpoint) -> None:
        """Take note that it has gone; harmless if it was never known."""


class Watch:
    """Tells a listener of the endpoints of one kind on one topic.

    Args:
        participant: Whose view counts.
        tell: The listener.
    """

    def __init__(self, participant: Participant, tell: Callable[[EndpointEvent], None]) -> None:
        self.participant = participant
        self._tell: Callable[[EndpointEvent], None] | None = tell
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


class Topic:
    """The endpoints of one DDS topic, and who watches them.

    Attributes:
        writers: In the order of their creation.
        readers: The same.
        fading: Those that are retracted while not everybody has heard so.
        watches: Watches of readers, and of writers.
    """

    __slots__ = ("fading", "readers", "watches", "writers")

    def __init__(self) -> None:
        self.writers: dict[Writer, None] = {}
        self.readers: dict[Reader, None] = {}
        self.fading: dict[Endpoint, None] = {}
        self.watches: tuple[dict[Watch, None], dict[Watch, None]] = ({}, {})

    def endpoints(self) -> Iterator[Endpoint]:
        """Yield all that somebody may know of."""
        yield from self.writers
        yield from self.readers
        yield from self.fading

    def same_kind(self, endpoint: Endpoint) -> dict[Endpoint, None]:
        """Return the index that an endpoint belongs to."""
        return self.writers if endpoint.is_writer else self.readers  # type: ignore[return-value]

    def counterparts(self, endpoint: Endpoint) -> dict[Endpoint, None]:
        """Return the index of what an endpoint may match."""
        return self.readers if endpoint.is_writer else self.writers  # type: ignore[return-value]


class Domain:
    """One DDS domain: of the whole network, or of one host's loopback interface.

    Args:
        world: Where it is.
        networked: Whether it spans hosts.

    Attributes:
        members: Who takes part.
        topics: By their DDS names.
        graphs: Those that somebody listens to.
        announced: How many endpoints it has had so far.
        crowd: Stands for all its processes: what all of them hear occupies each of them for as long.
    """

    def __init__(self, world: World, *, networked: bool) -> None:
        self.world = world
        self.members: dict[Participant, None] = {}
        self.topics: dict[str, Topic] = {}
        self.graphs: dict[Observer, None] = {}
        self.crowd = Process()
        self.announced = 0
        self.accounts = Accounts(
            self.members, world.hosts, world.loop, networked=networked, multicast=world.multicast
        )
        self._loop = world.loop
        self._views = world.views
        self._clockwork = world.clockwork

    def join(self, participant: Participant) -> None:
        """Let a participant in."""
        participant.born_ns = participant.ticked_ns = self._loop.now_ns
        participant.crowd_ns = self.crowd.spent_ns
        self._note("join", participant)
        self.accounts.joined(participant)
        self.members[participant] = None

    def leave(self, participant: Participant) -> None:
        """Let a participant go that says so: what it has is retracted."""
        for endpoint in list(participant.endpoints):
            self.retract(endpoint)
        participant.left_ns = self._loop.now_ns
        self._note("leave", participant)
        self.accounts.left(participant)
        del self.members[participant]

    def crash(self, participant: Participant) -> None:
        """Let a participant fall silent; the others notice when its lease runs out."""
        participant.crashed_ns = self._loop.now_ns
        self._note("crash", participant)
        self.accounts.crashed(participant)
        del self.members[participant]
        end_ns = self._views.lease_end_ns(participant, participant.crashed_ns)
        self._loop.at(end_ns, self._expire, participant)

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

    def watch(self, watch: Watch, dds_topic: str, *, writers: bool) -> Callable[[], None]:
        """Let a watch see one kind of endpoint of a topic, those known now at once; return what ends it."""
        topic = self.topic(dds_topic)
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
            if self._views.knows(participant, endpoint):
                observer.learn(endpoint)
            for time_ns in self._views.turns_ns(participant, endpoint):
                if time_ns > now_ns:
                    self._loop.at(time_ns, self._look, endpoint, [observer])

    def announce(self, endpoint: Endpoint) -> None:
        """Make a new endpoint known, and let it see whom it has to do with."""
        endpoint.born_ns = self._loop.now_ns
        self.announced += 1
        self._charge(endpoint)
        endpoint.participant.endpoints[endpoint] = None
        topic = endpoint.topic
        peers, observers = self._concerned(endpoint)
        topic.same_kind(endpoint)[endpoint] = None
        self._schedule(endpoint, observers)
        self.show(endpoint, peers)
        if endpoint.suspicion is not None:
            self.show(endpoint.suspicion, [w for w in topic.writers if not endpoint.suits(w)])
        self.accounts.announced(endpoint)

    def retract(self, endpoint: Endpoint) -> None:
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
        self._loop.at(max(last_ns, endpoint.gone_ns + self.world.network.slowest_ns), self._fade, endpoint)
        self.accounts.retracted(endpoint)

    def review(self, participant: Participant, other: Participant) -> None:
        """Let a participant's observers look again at all that another one has."""
        for endpoint in [e for e in self.endpoints() if e.participant is other]:
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
        return peers, [*peers, *observers, *topic.watches[endpoint.is_writer], *self.graphs]

    def _schedule(self, endpoint: Endpoint, observers: list[Observer]) -> int:
        """Let observers look whenever their view of an endpoint may change; return when the last one does."""
        groups: dict[int, list[Observer]] = {}
        for observer in observers:
            for time_ns in self._views.turns_ns(observer.participant, endpoint):
                groups.setdefault(time_ns, []).append(observer)
        for time_ns, group in groups.items():
            self._loop.at(time_ns, self._look, endpoint, group)
        return max(groups, default=self._loop.now_ns)

    def _look(self, endpoint: Endpoint, observers: list[Observer]) -> None:
        if not endpoint.fades and not self._views.partitions:
            for observer in observers:  # nothing can have happened but that the news has arrived
                observer.learn(endpoint)
            return
        for observer in observers:
            if self._views.knows(observer.participant, endpoint):
                observer.learn(endpoint)
            else:
                observer.forget(endpoint)

    def _fade(self, endpoint: Endpoint) -> None:
        """Drop a retracted endpoint when nobody can know it any more."""
        if self._views.partitions:
            if any(self._views.knows(member, endpoint) for member in self.members):
                self._loop.at(self._loop.now_ns + _LOOK_AGAIN_NS, self._fade, endpoint)
                return
            self._look(endpoint, self._concerned(endpoint)[1])  # a view may have changed at this very instant
        del endpoint.topic.fading[endpoint]

    def _expire(self, participant: Participant) -> None:
        for endpoint in list(participant.endpoints):
            del endpoint.topic.same_kind(endpoint)[endpoint]
            self._look(endpoint, self._concerned(endpoint)[1])
        participant.endpoints.clear()

    def _note(self, what: str, participant: Participant) -> None:
        if self.world.trace is not None:
            self.world.trace(what, participant.guid, participant.name.encode())

    def settle(self) -> None:
        """Bring the books up to date."""
        self.accounts.settle()
        for topic in self.topics.values():
            for writer in topic.writers:
                writer.audience.settle()

    def _charge(self, endpoint: Endpoint) -> None:
        """Let an announcement, or retraction, take the time that it costs its maker and everybody."""
        now_ns, clockwork = self._loop.now_ns, self._clockwork
        if clockwork.endpoint_cost_ns:
            endpoint.participant.process.occupy(now_ns, clockwork.endpoint_cost_ns)
        if clockwork.announcement_cost_ns and len(self.members) > 1:
            self.crowd.occupy(now_ns, clockwork.announcement_cost_ns)
            endpoint.backlog_ns = self.crowd.free_ns - now_ns
