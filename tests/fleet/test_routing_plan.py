"""The plan against a model of domains and routers: paths where they belong, once, and none left over."""

import itertools
from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule, run_state_machine_as_test

from sfglab.bus.api import EndpointAdded, EndpointInfo, EndpointKind, EndpointRemoved, user_data
from sfglab.fleet.policy import (
    TABLE_1,
    Crossing,
    Direction,
    ForwardRule,
    Policy,
    ReaderSpec,
    Side,
    WriterSpec,
)
from sfglab.fleet.router.plan import (
    REPLY_READER_TIMEOUT_NS,
    ROUTER_KEY,
    AssignRoute,
    Close,
    Open,
    Plan,
    RemoveSource,
)
from sfglab.fleet.router.ros import RosHalves
from sfglab.lab.checks.routing import in_table_1
from sfglab.names import ResourceKind
from sfglab.qos import DEFAULT, LATCHED, SENSOR_DATA, incompatibilities

SECOND = 10**9
POLICY = Policy()
REQUESTS, REPLIES = "rq/global/x/get_metadataRequest", "rr/global/x/get_metadataReply"
TOPICS = ("rt/tf_static", "rt/local/go2/scan", REQUESTS, REPLIES)
PROFILES = (DEFAULT, SENSOR_DATA, LATCHED, replace(LATCHED, depth=1000))
TYPES = ("std_msgs/msg/String", "std_msgs/msg/Header")
PUB, SUB = EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION
GLOBAL = 0


class World:
    """Domains with endpoints, and routers that hear of them late, in any interleaving."""

    def __init__(self, *, offers: bool = False) -> None:
        self.now_ns = 0
        self.offers = offers
        self.numbers = itertools.count(1)
        self.domains: dict[int, dict[bytes, EndpointInfo]] = {}
        self.routers: list[Router] = []

    def gid(self) -> bytes:
        return next(self.numbers).to_bytes(16, "big")

    def add(self, domain: int, endpoint: EndpointInfo) -> EndpointInfo:
        self.domains.setdefault(domain, {})[endpoint.gid] = endpoint
        self._tell(domain, EndpointAdded(endpoint=endpoint))
        return endpoint

    def remove(self, domain: int, gid: bytes) -> None:
        self._tell(domain, EndpointRemoved(endpoint=self.domains[domain].pop(gid)))

    def plain(self) -> list[tuple[int, EndpointInfo]]:
        return [
            (d, e) for d, known in self.domains.items() for e in known.values() if not e.user_data
        ]

    def routers_own(self) -> list[tuple[int, EndpointInfo]]:
        return [(d, e) for d, known in self.domains.items() for e in known.values() if e.user_data]

    def start_router(self, local: int, name: str):
        router = Router(self, local, name)
        self.routers.append(router)
        for side, domain in router.domains.items():
            for endpoint in self.domains.get(domain, {}).values():
                router.heard[side].append(EndpointAdded(endpoint=endpoint))
        return router

    def settle(self) -> None:
        """Let every router hear everything, and everything linger to its end."""
        for _ in range(200):
            for router in self.routers:
                for side in Side:
                    while router.heard[side]:
                        router.hear(side)
            self.now_ns += 2 * SECOND
            for router in self.routers:
                router.tick()
            if not any(router.heard[side] for router in self.routers for side in Side):
                return
        raise AssertionError("the routers never come to rest")

    def copies(self, domain: int, source: EndpointInfo, limit: int = 6) -> dict[bytes, int]:
        """Return how often each plain subscription gets a sample of a publisher."""
        assert limit, "a sample goes round for ever"
        got: dict[bytes, int] = {}
        for sink in self.domains[domain].values():
            if not matches(source, sink) or sink.participant == source.participant:
                continue
            if not sink.user_data:
                got[sink.gid] = got.get(sink.gid, 0) + 1
                continue
            for further, writer in self._onward(sink, source):
                for gid, count in self.copies(further, writer, limit - 1).items():
                    got[gid] = got.get(gid, 0) + count
        return got

    def _onward(self, reader: EndpointInfo, source: EndpointInfo):
        for router in self.routers:
            writer = router.judged.get((reader.gid, source.gid))
            if writer is not None:
                yield router.domain_of(writer), self.domains[router.domain_of(writer)][writer]

    def _tell(self, domain: int, event) -> None:
        for router in self.routers:
            for side, own in router.domains.items():
                if own == domain:
                    router.heard[side].append(event)


class Router:
    """Carries a plan's actions out in the world."""

    def __init__(self, world: World, local: int, name: str) -> None:
        self.world = world
        self.name = name
        self.domains = {Side.LOCAL: local, Side.GLOBAL: GLOBAL}
        self.participants = {side: world.gid() for side in Side}
        self.heard = {side: deque() for side in Side}
        self.tag = user_data({ROUTER_KEY: name})
        own = frozenset(self.participants.values())
        self.plan = Plan(
            POLICY,
            participants=own,
            tag=name,
            linger_ns=SECOND,
            advertise_unused_topics=world.offers,
        )
        self.open: dict[ReaderSpec | WriterSpec, bytes] = {}
        self.judged: dict[tuple[bytes, bytes], bytes | None] = {}
        self.done = []

    def hear(self, side: Side) -> None:
        self.apply(self.plan.feed([(side, self.heard[side].popleft())], now_ns=self.world.now_ns))

    def tick(self) -> None:
        self.apply(self.plan.feed((), now_ns=self.world.now_ns))

    def domain_of(self, gid: bytes) -> int:
        return next(d for d in self.domains.values() if gid in self.world.domains[d])

    def apply(self, actions) -> None:
        self.done += actions
        for action in actions:
            match action:
                case Open(what=spec):
                    assert spec not in self.open, "opened twice"
                    self.open[spec] = self._create(spec)
                case Close(what=spec):
                    gid = self.open.pop(spec)
                    self.world.remove(self.domain_of(gid), gid)
                    self.judged = {key: w for key, w in self.judged.items() if key[0] != gid}
                case AssignRoute(reader=reader, source=source, writer=writer):
                    self.judged[self.open[reader], source.gid] = (
                        self.open[writer] if writer else None
                    )
                case RemoveSource(reader=reader, source=gid):
                    self.judged.pop(
                        (self.open[reader], gid), None
                    )  # one that was held was never judged
        assert all(w is None or w in self.open.values() for w in self.judged.values())

    def restart(self) -> None:
        """End, with all its endpoints, and begin again in the same place as a new one."""
        place = self.world.routers.index(self)
        self.world.routers.remove(self)
        for gid in self.open.values():
            self.world.remove(self.domain_of(gid), gid)
        self.world.start_router(self.domains[Side.LOCAL], self.name)
        self.world.routers.insert(place, self.world.routers.pop())

    def _create(self, spec) -> bytes:
        way, reads = spec.path.direction, isinstance(spec, ReaderSpec)
        side = way.source if reads else way.target
        made = plain(
            self.world, SUB if reads else PUB, spec.path.dds_topic, spec.qos, spec.path.type
        )
        endpoint = replace(made, participant=self.participants[side], user_data=self.tag)
        return self.world.add(self.domains[side], endpoint).gid


def matches(source: EndpointInfo, sink: EndpointInfo) -> bool:
    kinds = source.kind is PUB and sink.kind is SUB
    same = source.dds_topic == sink.dds_topic and source.type == sink.type
    return kinds and same and not incompatibilities(offered=source.qos, requested=sink.qos)


def plain(world, kind, topic, qos=DEFAULT, type_=TYPES[0]) -> EndpointInfo:
    gid = world.gid()
    return EndpointInfo(
        kind=kind, topic=topic, dds_topic=topic, type=type_, gid=gid, qos=qos, participant=gid
    )


class Fleet(RuleBasedStateMachine):
    """Two agents and the global domain; endpoints and routers come and go, events arrive whenever."""

    agents = (1, 2)
    names = ("host/1", "host/2")
    offers = False

    def __init__(self) -> None:
        super().__init__()
        self.world = World(offers=self.offers)
        for local, name in zip(self.agents, self.names, strict=True):
            self.world.start_router(local, name)

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
            router.tick()

    @rule(which=st.integers(0, 1))
    def crash_and_restart(self, which):
        self.world.routers[which].restart()

    @invariant()
    def nothing_forbidden_is_ever_opened(self):
        for router in self.world.routers:
            assert all(POLICY.crosses(s.path.dds_topic, s.path.direction) for s in router.open)

    @rule()
    def every_subscription_hears_what_it_should_once(self):
        self.world.settle()
        for domain, source in self.world.plain():
            got = self.world.copies(domain, source)
            for other, sink in self.world.plain():
                if source.kind is PUB and sink.kind is SUB:
                    crosses = POLICY.crosses(source.dds_topic, Direction.OUTWARD)
                    wanted = self.copies_wanted(domain, other, crosses=crosses) * matches(
                        source, sink
                    )
                    assert got.get(sink.gid, 0) == wanted

    def copies_wanted(self, domain, other, *, crosses) -> int:
        return other == domain or crosses

    @rule()
    def what_is_open_is_what_is_used(self):
        self.world.settle()
        for router in self.world.routers:
            for spec in router.open:
                way = spec.path.direction
                state = router.plan.paths[spec.path]
                needs_source = isinstance(spec, WriterSpec) or way is Direction.OUTWARD
                assert state.sinks or (self.offers and isinstance(spec, WriterSpec))
                assert state.sources or not needs_source

    @rule()
    def no_sample_waits_for_a_judgement(self):
        self.world.settle()
        for router in self.world.routers:
            for spec in (spec for spec in router.open if isinstance(spec, ReaderSpec)):
                side = spec.path.direction.source
                known = self.world.domains[router.domains[side]]
                reader = known[router.open[spec]]
                others = [e for e in known.values() if e.participant != reader.participant]
                heard = {e.gid for e in others if matches(e, reader)}
                assert heard <= {gid for r, gid in router.judged if r == reader.gid}
                assert not set(router.open.values()) & set(
                    router.plan.paths[spec.path].blocked_publishers
                )

    def teardown(self):
        for domain, endpoint in self.world.plain():
            self.world.remove(domain, endpoint.gid)
        self.world.settle()
        assert self.world.routers_own() == [], "nothing remains when all have left"
        assert all(router.plan.paths == {} for router in self.world.routers)


class OfferingFleet(Fleet):
    """The same where routers offer what they could open: all of it is visible, and nothing else is read."""

    offers = True

    @rule()
    def what_could_come_is_listed(self):
        self.world.settle()
        for domain, source in self.world.plain():
            if source.kind is PUB and source.dds_topic == "rt/tf_static":
                for other in {GLOBAL, 1, 2} - {domain}:
                    seen = self.world.domains.get(other, {}).values()
                    assert any(matches(e, replace(source, kind=SUB)) for e in seen), (domain, other)


class DoubledFleet(Fleet):
    """The same with an orphaned second router on one agent's pair: twice, but never round and round."""

    agents = (1, 1)
    names = ("host/1", "host/1")

    def copies_wanted(self, domain, other, *, crosses) -> int:
        return 1 if other == domain else 2 * (crosses and {domain, other} == {GLOBAL, 1})


class CrossedFleet(Fleet):
    """Two hosts that share a local domain by mistake: no router can know, and still nothing goes round."""

    agents = (1, 1)
    names = ("a/1", "b/1")

    @rule()
    def every_subscription_hears_what_it_should_once(self):
        self.world.settle()
        for domain, source in self.world.plain():
            self.world.copies(domain, source)


_SETTINGS = settings(
    max_examples=150,
    stateful_step_count=30,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)


@pytest.mark.parametrize("machine", [Fleet, OfferingFleet, DoubledFleet, CrossedFleet])
def test_paths_are_where_they_belong_whatever_comes_and_goes(machine):
    run_state_machine_as_test(machine, settings=_SETTINGS)


def two_agents(*, offers: bool = False) -> tuple[World, Router, Router]:
    world = World(offers=offers)
    return world, world.start_router(1, "host/1"), world.start_router(2, "host/2")


def test_shared_memory_is_never_announced():
    world, one, _ = two_agents()
    world.add(1, replace(plain(world, PUB, "rt/tf"), transport="shm"))
    world.add(GLOBAL, plain(world, SUB, "rt/tf"))
    world.add(1, replace(plain(world, SUB, "rt/tf"), transport="shm"))
    world.settle()
    assert one.open == {}


@pytest.mark.parametrize(("qos", "kept"), [(DEFAULT, True), (SENSOR_DATA, True), (LATCHED, False)])
def test_an_offer_becomes_the_writer_unless_it_would_keep_what_an_earlier_demand_left(qos, kept):
    world, one, two = two_agents(offers=True)
    topic = "rt/global/a/pose"
    world.add(1, plain(world, PUB, topic, qos))
    world.add(1, plain(world, PUB, REPLIES))
    for _ in range(2):
        world.settle()
        offers = [dict(router.open) for router in (one, two)]
        assert [[(type(s), s.path.dds_topic, s.qos.durability) for s in o] for o in offers] == 2 * [
            [(WriterSpec, topic, qos.durability)]
        ]
        sink = world.add(2, plain(world, SUB, topic, qos))
        world.settle()
        for router, before in zip((one, two), offers, strict=True):
            assert (before.items() <= router.open.items()) is kept
            assert sorted(type(s).__name__ for s in router.open) == ["ReaderSpec", "WriterSpec"]
        world.remove(2, sink.gid)


def test_latched_sources_get_a_writer_each_that_goes_with_them_and_volatile_ones_share():
    world, one, _ = two_agents()
    for qos, topic in ((LATCHED, "rt/tf_static"), (DEFAULT, "rt/tf")):
        for _ in range(3):
            world.add(1, plain(world, PUB, topic, qos))
        world.add(GLOBAL, plain(world, SUB, topic, qos))
    world.settle()
    writers = [spec for spec in one.open if isinstance(spec, WriterSpec)]
    assert sorted(w.path.dds_topic for w in writers) == ["rt/tf", *3 * ["rt/tf_static"]]
    assert len({w.source for w in writers}) == 4
    world, one, _ = two_agents()
    kept, leaving = (world.add(1, plain(world, PUB, "rt/tf_static", LATCHED)) for _ in range(2))
    world.add(GLOBAL, plain(world, SUB, "rt/tf_static", LATCHED))
    world.settle()
    one.done.clear()
    world.remove(1, leaving.gid)
    world.settle()
    assert [type(a) for a in one.done] == [RemoveSource, Close]
    assert one.done[1].what.source == leaving.gid
    assert [spec.source for spec in one.open if isinstance(spec, WriterSpec)] == [kept.gid]


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
        one.tick()
        sink = world.add(GLOBAL, plain(world, SUB, "rt/tf"))
        one.hear(Side.GLOBAL)
    assert one.done == [], "a restart tears nothing down"
    world.remove(GLOBAL, sink.gid)
    one.hear(Side.GLOBAL)
    world.now_ns += SECOND - 1
    one.tick()
    assert one.done == []
    assert one.plan.deadline_ns == world.now_ns + 1
    world.now_ns += 1
    one.tick()
    assert [type(a) for a in one.done] == [Close, Close]
    assert one.plan.deadline_ns is None


class Services:
    """A server, and clients whose two halves discovery tells of one by one, behind one router."""

    def __init__(self, server: int, client: int) -> None:
        self.world, self.router, _ = two_agents()
        self.client = client
        self.participants: dict[str, bytes] = {}
        for kind, topic in ((SUB, REQUESTS), (PUB, REPLIES)):
            self.world.add(server, plain(self.world, kind, topic))

    def half(self, who: str, kind: EndpointKind) -> EndpointInfo:
        """Tell of a half of a client; those called by one letter and numbers share a participant."""
        participant = self.participants.setdefault(who[0], self.world.gid())
        tag = user_data({"clientid": who}) if who[1:] else b""
        made = plain(self.world, kind, REQUESTS if kind is PUB else REPLIES)
        return self.world.add(self.client, replace(made, user_data=tag, participant=participant))

    def hear(self) -> None:
        for side in 2 * tuple(Side):
            while self.router.heard[side]:
                self.router.hear(side)

    def passes(self, writer: EndpointInfo) -> bool | None:
        """Return whether a publisher's samples go somewhere; None while they are held."""
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
    for step in steps.split(", "):
        who, _, what = step.rpartition(" ")
        if what == "asks":
            writer = services.half(who, PUB)
        elif what == "listens":
            reader = services.half(who, SUB)
        elif what == "leaves":
            services.world.remove(client, reader.gid)
        services.hear()
        if what == "held":
            assert services.passes(writer) is None
        elif what == "passes":
            assert services.passes(writer)
            assert services.router.plan.deadline_ns is None
            writers = {s.path.dds_topic for s in services.router.open if isinstance(s, WriterSpec)}
            assert writers == {REQUESTS, REPLIES}


def test_a_request_does_not_wait_for_ever_and_a_client_that_left_is_forgotten():
    services = Services(1, GLOBAL)
    world, one = services.world, services.router
    silent, gone = (services.half(who, PUB) for who in "ab")
    services.hear()
    assert one.plan.deadline_ns == REPLY_READER_TIMEOUT_NS
    world.remove(GLOBAL, gone.gid)
    services.hear()
    world.now_ns = SECOND
    one.tick()
    assert services.passes(gone) is None
    assert [a.source for a in one.done if isinstance(a, RemoveSource)] == [gone.gid]
    world.now_ns = REPLY_READER_TIMEOUT_NS
    one.tick()
    assert services.passes(silent)
    assert one.plan.deadline_ns is None


# --- Policies other than Table 1: rules of one direction, half of a service, and more rules.

segments = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
near = st.sampled_from(
    ["global", "local", "tf", "tf_static", "globally", "global_x", "GLOBAL", "tf2"]
)
ros_names = st.lists(near | segments, min_size=1, max_size=5).map("/".join)
tails = st.sampled_from(["", "Request", "Reply", "/_action/feedback"])
prefixes = st.sampled_from(["rt", "rq", "rr", "rs", "rp", "RT", "rt ", ""])
dds_names = st.builds(lambda p, n, t: f"{p}/{n}{t}", prefixes, ros_names, tails) | st.text(
    max_size=30
)


@given(dds_names)
def test_a_rule_of_one_direction_lets_nothing_cross_against_it(name):
    outward = tuple(replace(rule, directions=frozenset({Direction.OUTWARD})) for rule in TABLE_1)
    policy = Policy(rules=outward)
    assert policy.crosses(name, Direction.OUTWARD) is in_table_1(name)
    assert not policy.crosses(name, Direction.INWARD)
    assert policy.domains(name, Side.GLOBAL) == frozenset({Side.GLOBAL})


def test_a_service_whose_replies_stay_is_half_open():
    policy = Policy(rules=tuple(rule for rule in TABLE_1 if rule.pattern != "rr/global/*"))
    crossing = policy.crossing("/global/go2/get_metadata", ResourceKind.SERVICE, Direction.OUTWARD)
    assert crossing is Crossing.PARTIAL


@given(
    st.lists(
        st.sampled_from([rule.pattern for rule in TABLE_1] + ["rt/local/*", "*", "rt/??"]),
        max_size=3,
    ),
    dds_names,
)
def test_more_rules_never_let_less_cross(patterns, name):
    rules = tuple(ForwardRule(pattern=pattern, description="") for pattern in patterns)
    more = Policy(rules=(*TABLE_1, *rules))
    for way in Direction:
        assert more.crosses(name, way) >= Policy().crosses(name, way)


@pytest.mark.parametrize(
    ("kind", "data", "transports"),
    [
        (PUB, b"", {"dds", "ros"}),
        (PUB, user_data({"clientid": "7"}), {"dds", "ros"}),
        (PUB, user_data({ROUTER_KEY: "another"}), {"dds"}),
        (SUB, b"", {"dds"}),
    ],
    ids=["client", "client of Cyclone", "router", "server"],
)
def test_what_a_framed_client_asks_is_served_by_ros_2_too_and_nothing_else_framed(
    kind, data, transports
):
    services, heard = SimpleNamespace(find=lambda _type, _asker, told: told("")), []
    halves = RosHalves(
        services, POLICY, lambda _, event: heard.append((type(event), event.endpoint.transport))
    )
    half = EndpointInfo(
        kind=kind, topic="", type="x/srv/X_Request", gid=b"g", qos=DEFAULT, user_data=data
    )
    for event in (EndpointAdded, EndpointRemoved):
        halves.feed(Side.LOCAL, event(endpoint=replace(half, dds_topic=REQUESTS)))
        assert set(heard) == {(event, transport) for transport in transports}
        heard.clear()
