"""The plan against a model of domains and routers: paths where they belong, once, and none left over."""

import itertools
from collections import defaultdict, deque
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from sfglab.bus.api import EndpointAdded, EndpointInfo, EndpointKind, EndpointRemoved, user_data
from sfglab.fleet.policy import Direction, Policy, ReaderSpec, Side, WriterSpec
from sfglab.fleet.router.plan import (
    REPLY_READER_TIMEOUT_NS,
    ROUTER_KEY,
    AssignRoute,
    Close,
    Open,
    Plan,
    RemoveSource,
)
from sfglab.qos import DEFAULT, LATCHED, SENSOR_DATA, incompatibilities

SECOND = 10**9
POLICY = Policy()
POSE = "rt/global/a/pose"
REQUESTS, REPLIES = "rq/global/x/get_metadataRequest", "rr/global/x/get_metadataReply"
TOPICS = ("rt/tf_static", "rt/local/go2/scan", REQUESTS, REPLIES)
PROFILES = (DEFAULT, SENSOR_DATA, LATCHED, replace(LATCHED, depth=1000))
TYPES = ("std_msgs/msg/String", "std_msgs/msg/Header")
PUB, SUB = EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION
GLOBAL = 0


class World:
    """Domains with endpoints, and routers that hear of them late, in any interleaving."""

    def __init__(self, *, offers=False):
        self.now_ns = 0
        self.offers = offers
        self.numbers = itertools.count(1)
        self.domains = defaultdict(dict)
        self.routers = []

    def gid(self):
        return next(self.numbers).to_bytes(16, "big")

    def add(self, domain, endpoint):
        self.domains[domain][endpoint.gid] = endpoint
        self._tell(domain, EndpointAdded(endpoint=endpoint))
        return endpoint

    def remove(self, domain, gid):
        self._tell(domain, EndpointRemoved(endpoint=self.domains[domain].pop(gid)))

    def plain(self):
        return [
            (d, e) for d, known in self.domains.items() for e in known.values() if not e.user_data
        ]

    def settle(self):
        """Let every router hear everything, and everything linger to its end."""
        for _ in range(200):
            for router in self.routers:
                router.hear_all()
            self.now_ns += 2 * SECOND
            for router in self.routers:
                router.feed()
            if not any(any(router.heard.values()) for router in self.routers):
                return
        raise AssertionError("the routers never come to rest")

    def copies(self, domain, source, limit=6):
        """Return how often each plain subscription gets a sample of a publisher."""
        assert limit, "a sample goes round for ever"
        got = {}
        for sink in self.domains[domain].values():
            if not matches(source, sink) or sink.participant == source.participant:
                continue
            if not sink.user_data:
                got[sink.gid] = got.get(sink.gid, 0) + 1
            for router in self.routers:
                if (spec := router.judged.get((sink.gid, source.gid))) is not None:
                    further, writer = router.domain_of(spec), router.open[spec]
                    onward = self.copies(further, self.domains[further][writer], limit - 1)
                    for gid, count in onward.items():
                        got[gid] = got.get(gid, 0) + count
        return got

    def _tell(self, domain, event):
        for router in self.routers:
            for side, own in router.domains.items():
                if own == domain:
                    router.heard[side].append(event)


class Router:
    """A router in the world, which carries its plan's actions out there."""

    def __init__(self, world, local, name):
        self.world = world
        self.name = name
        self.domains = {Side.LOCAL: local, Side.GLOBAL: GLOBAL}
        self.participants = {side: world.gid() for side in Side}
        self.heard = {
            side: deque(EndpointAdded(endpoint=e) for e in world.domains[domain].values())
            for side, domain in self.domains.items()
        }
        self.plan = Plan(
            POLICY,
            participants=frozenset(self.participants.values()),
            tag=name,
            linger_ns=SECOND,
            advertise_unused_topics=world.offers,
        )
        self.open = {}
        self.judged = {}
        self.done = []
        world.routers.append(self)

    def feed(self, *events):
        """Have the plan take events and the time, and carry its actions out."""
        actions = self.plan.feed(events, now_ns=self.world.now_ns)
        self.done += actions
        for action in actions:
            match action:
                case Open(what=spec):
                    assert spec not in self.open, "opened twice"
                    self.open[spec] = self._create(spec)
                case Close(what=spec):
                    gid = self.open.pop(spec)
                    self.world.remove(self.domain_of(spec), gid)
                    self.judged = {key: w for key, w in self.judged.items() if key[0] != gid}
                case AssignRoute(reader=reader, source=source, writer=writer):
                    self.judged[self.open[reader], source.gid] = writer
                case RemoveSource(reader=reader, source=gid):
                    self.judged.pop((self.open[reader], gid), None)  # a held one was never judged
        assert {writer for writer in self.judged.values() if writer} <= self.open.keys()

    def hear(self, side):
        self.feed((side, self.heard[side].popleft()))

    def hear_all(self):
        while side := next((side for side in Side if self.heard[side]), None):
            self.hear(side)

    def side_of(self, spec):
        way = spec.path.direction
        return way.source if isinstance(spec, ReaderSpec) else way.target

    def domain_of(self, spec):
        return self.domains[self.side_of(spec)]

    def restart(self):
        """End, with all its endpoints, and begin again as a new one."""
        self.world.routers.remove(self)
        for spec, gid in self.open.items():
            self.world.remove(self.domain_of(spec), gid)
        Router(self.world, self.domains[Side.LOCAL], self.name)

    def _create(self, spec):
        kind = SUB if isinstance(spec, ReaderSpec) else PUB
        made = plain(self.world, kind, spec.path.dds_topic, spec.qos, spec.path.type)
        own = {
            "participant": self.participants[self.side_of(spec)],
            "user_data": user_data({ROUTER_KEY: self.name}),
        }
        return self.world.add(self.domain_of(spec), replace(made, **own)).gid


def matches(source, sink):
    kinds = source.kind is PUB and sink.kind is SUB
    same = source.dds_topic == sink.dds_topic and source.type == sink.type
    return kinds and same and not incompatibilities(offered=source.qos, requested=sink.qos)


def plain(world, kind, topic, qos=DEFAULT, type_=TYPES[0]):
    gid = world.gid()
    return EndpointInfo(
        kind=kind, topic=topic, dds_topic=topic, type=type_, gid=gid, qos=qos, participant=gid
    )


class Fleet(RuleBasedStateMachine):
    """Two agents and the global domain; endpoints and routers come and go, events arrive whenever."""

    agents = (1, 2)
    names = ("host/1", "host/2")
    offers = False

    def __init__(self):
        super().__init__()
        self.world = World(offers=self.offers)
        for local, name in zip(self.agents, self.names, strict=True):
            Router(self.world, local, name)

    @rule(
        domain=st.sampled_from((GLOBAL, 1, 2)),
        kind=st.sampled_from(EndpointKind),
        topic=st.sampled_from(TOPICS),
        qos=st.sampled_from(PROFILES),
        type_=st.sampled_from((TYPES[0], *TYPES)),
    )
    def come(self, domain, kind, topic, qos, type_):
        self.world.add(domain, plain(self.world, kind, topic, qos, type_))

    @rule(data=st.data())
    def go(self, data):
        present = self.world.plain()
        if present:
            domain, endpoint = data.draw(st.sampled_from(present))
            self.world.remove(domain, endpoint.gid)

    @rule(which=st.integers(0, 1), side=st.sampled_from(Side))
    def hear(self, which, side):
        router = self.world.routers[which]
        if router.heard[side]:
            router.hear(side)

    @rule(seconds=st.sampled_from((0.1, 0.5, 1.5)))
    def wait(self, seconds):
        self.world.now_ns += round(seconds * SECOND)
        for router in self.world.routers:
            router.feed()

    @rule(which=st.integers(0, 1))
    def crash_and_restart(self, which):
        self.world.routers[which].restart()

    @invariant()
    def nothing_forbidden_is_ever_opened(self):
        for router in self.world.routers:
            assert all(POLICY.crosses(s.path.dds_topic, s.path.direction) for s in router.open)

    @rule()
    def when_all_has_been_heard_every_subscription_hears_what_it_should_once(self):
        self.world.settle()
        for domain, source in self.world.plain():
            got = self.world.copies(domain, source)
            crosses = POLICY.crosses(source.dds_topic, Direction.OUTWARD)
            for other, sink in self.world.plain():
                wanted = self.copies_wanted(domain, other, crosses=crosses)
                if wanted is not None:
                    assert got.get(sink.gid, 0) == wanted * matches(source, sink)
        for router in self.world.routers:
            for spec in router.open:
                self.is_used(router, spec)

    def copies_wanted(self, domain, other, *, crosses):
        return other == domain or crosses

    def is_used(self, router, spec):
        """Check that an open reader or writer is needed, and that samples are judged."""
        state = router.plan.paths[spec.path]
        if isinstance(spec, WriterSpec):
            assert state.sources
            assert state.sinks or self.offers
            return
        assert state.sinks
        assert state.sources or spec.path.direction is Direction.INWARD
        known = self.world.domains[router.domain_of(spec)].values()
        reader = router.open[spec]
        own = router.participants[router.side_of(spec)]
        sink = next(e for e in known if e.gid == reader)
        heard = {e.gid for e in known if matches(e, sink) and e.participant != own}
        assert heard <= {gid for judging, gid in router.judged if judging == reader}
        assert not set(router.open.values()) & set(state.blocked_publishers)

    def teardown(self):
        for domain, endpoint in self.world.plain():
            self.world.remove(domain, endpoint.gid)
        self.world.settle()
        assert not any(self.world.domains.values()), "nothing remains when all have left"
        assert all(router.plan.paths == {} for router in self.world.routers)


class OfferingFleet(Fleet):
    """Fleet whose routers also advertise topics without a subscriber."""

    offers = True


class DoubledFleet(Fleet):
    """The same with an orphaned second router on one agent's pair: twice, but never round and round."""

    agents = (1, 1)
    names = ("host/1", "host/1")

    def copies_wanted(self, domain, other, *, crosses):
        return 1 if other == domain else 2 * (crosses and {domain, other} == {GLOBAL, 1})


class CrossedFleet(Fleet):
    """Two hosts that share a local domain by mistake: no router can know, and still nothing goes round."""

    agents = (1, 1)
    names = ("a/1", "b/1")

    def copies_wanted(self, *_, **__):
        return None


_SETTINGS = settings(
    max_examples=100,
    stateful_step_count=30,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)


@pytest.mark.parametrize("machine", [Fleet, OfferingFleet, DoubledFleet, CrossedFleet])
def test_paths_are_where_they_belong_whatever_comes_and_goes(machine):
    run_state_machine_as_test(machine, settings=_SETTINGS)


def two_agents(*, offers=False):
    world = World(offers=offers)
    return world, Router(world, 1, "host/1"), Router(world, 2, "host/2")


@pytest.mark.parametrize(("qos", "kept"), [(DEFAULT, True), (SENSOR_DATA, True), (LATCHED, False)])
def test_an_offer_becomes_the_writer_unless_it_would_keep_what_an_earlier_demand_left(qos, kept):
    world, *routers = two_agents(offers=True)
    world.add(1, plain(world, PUB, POSE, qos))
    for _ in range(2):
        world.settle()
        offers = [dict(router.open) for router in routers]
        assert [[(type(s), s.qos.durability) for s in o] for o in offers] == 2 * [
            [(WriterSpec, qos.durability)]
        ]
        sink = world.add(2, plain(world, SUB, POSE, qos))
        world.settle()
        for router, before in zip(routers, offers, strict=True):
            assert (before.items() <= router.open.items()) is kept
        world.remove(2, sink.gid)


def test_volatile_sources_share_a_writer_and_shared_memory_is_never_announced():
    world, one, _ = two_agents()
    for _ in range(3):
        world.add(1, plain(world, PUB, "rt/tf"))
    world.add(1, replace(plain(world, PUB, POSE), transport="shm"))
    for topic in ("rt/tf", POSE):
        world.add(GLOBAL, plain(world, SUB, topic))
    world.settle()
    assert [spec.path.dds_topic for spec in one.open] == 2 * ["rt/tf"], "a reader and a writer"


def test_a_subscription_that_returns_within_the_linger_changes_nothing():
    world, one, _ = two_agents()
    world.add(1, plain(world, PUB, "rt/tf"))
    sink = world.add(GLOBAL, plain(world, SUB, "rt/tf"))
    world.settle()
    one.done.clear()
    for _ in range(5):
        world.remove(GLOBAL, sink.gid)
        one.hear(Side.GLOBAL)
        world.now_ns += SECOND // 2
        one.feed()
        sink = world.add(GLOBAL, plain(world, SUB, "rt/tf"))
        one.hear(Side.GLOBAL)
    world.remove(GLOBAL, sink.gid)
    one.hear(Side.GLOBAL)
    for wait_ns in (SECOND - 1, 1):
        assert one.done == []
        world.now_ns += wait_ns
        one.feed()
    assert [type(a) for a in one.done] == [Close, Close]
    assert one.plan.deadline_ns is None


class Services:
    """A server, and clients whose two halves discovery tells of one by one, behind one router."""

    def __init__(self, server, client):
        self.world, self.router, _ = two_agents()
        self.client = client
        self.participants = defaultdict(self.world.gid)
        for kind, topic in ((SUB, REQUESTS), (PUB, REPLIES)):
            self.world.add(server, plain(self.world, kind, topic))

    def half(self, who, kind):
        """Tell of a half of a client; those called by one letter and numbers share a participant."""
        made = plain(self.world, kind, REQUESTS if kind is PUB else REPLIES)
        tag = user_data({"clientid": who}) if who[1:] else b""
        made = replace(made, user_data=tag, participant=self.participants[who[0]])
        return self.world.add(self.client, made)

    def passes(self, writer):
        """Return whether a publisher's samples go somewhere; None while they are held."""
        self.router.hear_all()
        goals = [to for (_, source), to in self.router.judged.items() if source == writer.gid]
        return any(goals) if goals else None


@pytest.mark.parametrize(("server", "client"), [(1, GLOBAL), (GLOBAL, 1)])
@pytest.mark.parametrize(
    "steps",
    [
        pytest.param("a asks, held, a listens, passes", id="until that is known"),
        pytest.param("a listens, a asks, passes", id="not if that was known before"),
        pytest.param(
            "b listens, a asks, held, a listens, passes", id="another client's does not count"
        ),
        pytest.param(
            "p1 listens, p2 asks, held, p2 listens, passes", id="nor one of the same participant"
        ),
        pytest.param(
            "a listens, a leaves, a asks, held", id="one that left lingers, and hears nothing"
        ),
    ],
)
def test_a_request_waits_for_the_reader_of_its_reply(server, client, steps):
    services = Services(server, client)
    halves = {}
    for step in steps.split(", "):
        who, _, what = step.rpartition(" ")
        if what in ("asks", "listens"):
            halves[what] = services.half(who, PUB if what == "asks" else SUB)
        elif what == "leaves":
            services.world.remove(client, halves["listens"].gid)
        else:
            assert services.passes(halves["asks"]) is (True if what == "passes" else None)
        services.router.hear_all()


def test_a_request_does_not_wait_for_ever_and_a_client_that_left_is_forgotten():
    services = Services(1, GLOBAL)
    world, one = services.world, services.router
    silent, gone = (services.half(who, PUB) for who in "ab")
    assert services.passes(silent) is services.passes(gone) is None
    assert one.plan.deadline_ns == REPLY_READER_TIMEOUT_NS
    world.remove(GLOBAL, gone.gid)
    one.hear_all()
    for world.now_ns in (SECOND, REPLY_READER_TIMEOUT_NS):
        one.feed()
    assert (services.passes(silent), services.passes(gone)) == (True, None)
    assert [a.source for a in one.done if isinstance(a, RemoveSource)] == [gone.gid]
    assert one.plan.deadline_ns is None
