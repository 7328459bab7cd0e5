"""Announcements of unknown agents, and agents that come late: one test per weakness that was found."""

import asyncio
import sys
from contextlib import asynccontextmanager
from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest
from cameras import FFMPEG, IMAGE, LOCAL, STREAM, behind_router
from test_decoder_streams import metadata
from test_discovery_registry import BEAT, TIMING, S, World
from test_routing_frames import GO2, pairs, tf

from sfglab.bus import Node
from sfglab.bus.sim.backend import SimClock
from sfglab.component import beside
from sfglab.fleet.decoder.node import AgentDecoder
from sfglab.fleet.decoder.pipeline import Statistics
from sfglab.fleet.decoder.streams import Route, routes_of_agent
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.discovery.registry import Registry
from sfglab.fleet.discovery.validation import MAX_STREAMS, validated_metadata
from sfglab.fleet.router import frames
from sfglab.fleet.router.frames import MAX_FRAME, TF_TYPE, TransformGate
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, heartbeat_topic
from sfglab.fleet.status.node import StatusProvider
from sfglab.messages import default_message, deserialize
from sfglab.qos import LATCHED, QoSProfile

sim = pytest.fixture(lambda: {"seed": 1, "limit_s": 90})


def several(*streams):
    whole = metadata(streams[0])
    whole.sensors[0].streams = [one.sensors[0].streams[0] for one in map(metadata, streams)]
    return whole


@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("decoded_topic", "/local/spot/camera_front/color/image_raw", "local scope"),
        ("decoded_topic", "/global/go2/camera_front/color/image_raw", "local scope"),
        ("decoded_topic", "/local/go2/../spot", "name"),
        (
            "camera_info_topic",
            "/global/spot/camera_front/color/camera_info",
            "the name is of another agent or of none",
        ),
        ("topic", "/local/go2/camera_front/color/ffmpeg", "global scope"),
        ("topic", "/" + "x" * 60_000, "topic"),
        ("type", "x" * 300, "type"),
        ("type", "../../etc/passwd", "type"),
        ("codec", "rm -rf", "codec"),
        ("width", 2**32 - 1, "pixels"),
        ("rate_hz", float("nan"), "Hz"),
    ],
    ids=lambda value: str(value)[:20],
)
def test_a_stream_that_says_what_it_must_not_is_left_out_with_a_sentence_and_the_others_stay(
    field, value, why
):
    good = "/global/go2/camera_rear/color/ffmpeg"
    bad = several(STREAM, good)
    setattr(bad.sensors[0].streams[0], field, value)
    kept, (error,) = validated_metadata(bad)
    assert [stream.topic for stream in kept.sensors[0].streams] == [good]
    assert (why in str(error), len(str(error)) < 1000, "\n" in str(error)) == (True, True, False)
    assert [route.source_topic for route in routes_of_agent(bad)[0]] == [good]


def test_of_two_of_one_name_the_first_counts_and_numbers_and_lengths_are_bounded():
    twice = several(STREAM, "/global/go2/camera_rear/color/ffmpeg")
    twice.sensors[0].streams[1].decoded_topic = LOCAL
    routes, (error,) = routes_of_agent(twice)
    assert ([route.source_topic for route in routes], "another stream" in str(error)) == (
        [STREAM],
        True,
    )
    many = several(*(f"/global/go2/camera_front_{n}/color/ffmpeg" for n in range(1000)))
    many.software = ["x" * 1000, "a\nb", "sfglab 1"]
    kept, errors = validated_metadata(many)
    assert (len(kept.sensors[0].streams), kept.software) == (MAX_STREAMS, ["sfglab 1"])
    assert "2 are not" in str(errors[-1])


class Pipe:
    """A pipeline process that opens at once, and closes when the test lets it."""

    status = None

    def __init__(self, owner, pid):
        self.owner, self.pid, self.closing, self.stream = owner, pid, False, None

    def order(self, **values):
        self.closing = values["do"] == "close"
        if values["do"] == "open":
            self.stream = values["stream"]
            self.says("opened")

    def says(self, what, **more):
        self.owner(self, {"is": what, **more})

    def signal(self, number):
        self.says("ended", status=-number)

    async def end(self):
        pass


class Pool(list):
    """Lends pipes."""

    async def acquire(self, owner):
        self.append(Pipe(owner, len(self) + 1))
        return self[-1]

    async def release(self, pipe):
        pipe.closing = False


@asynccontextmanager
async def decoding(world, **options):
    """A decoder whose topic a viewer wants: what it started, ways to offer and to let end, its node and the viewer."""
    async with world.node("decoder", host="pc") as node:
        viewer = node.create_subscription(IMAGE, LOCAL)
        states = {}
        decoder = AgentDecoder(
            node,
            pool := Pool(),
            advertise_unused_topics=False,
            **options,
            on_status=lambda status: states.update({status.local_topic: status.state}),
        )

        async def offer(agent, *codecs):
            stream = {"source_topic": STREAM, "source_type": FFMPEG, "local_topic": LOCAL}
            stream["replay_topic"] = f"{STREAM}_replay"
            decoder.offer(agent, [Route(agent=agent, codec=codec, **stream) for codec in codecs])
            await asyncio.sleep(0.5)

        async def let_end():
            for pipe in [pipe for pipe in pool if pipe.closing]:
                pipe.says("closed")
            await asyncio.sleep(0.5)
            return list(states.values())

        async with beside(decoder.run()) as (task,):
            yield SimpleNamespace(
                pool=pool, offer=offer, let_end=let_end, node=node, viewer=viewer, task=task
            )


@pytest.mark.parametrize("back", ["h264", "hevc"], ids=["as it was", "changed"])
async def test_a_stream_that_returns_while_its_old_pipeline_still_leaves_is_decoded_again(
    sim, back
):
    async with decoding(sim) as it:
        for codecs in (["h264"], [], [], [back]):
            await it.offer("go2", *codecs)
        assert await it.let_end() == ["RUNNING"]
        assert [pipe.stream.codec for pipe in it.pool] == ["h264", back]


async def test_who_came_second_is_decoded_when_the_first_has_gone(sim, caplog):
    async with decoding(sim) as it:
        for agent in ("evil", "go2", "spot"):
            await it.offer(agent, "h264")
        assert "offered by evil already" in caplog.text
        for agent in ("spot", "evil"):
            await it.offer(agent)
        assert await it.let_end() == ["RUNNING"]
        assert [pipe.stream.agent for pipe in it.pool] == ["evil", "go2"]
        await it.offer("go2")
        assert await it.let_end() == ["GONE"]


@pytest.mark.parametrize("spare", [False, True], ids=["which had begun", "a spare that never does"])
async def test_a_pipeline_process_that_hangs_is_replaced(sim, caplog, monkeypatch, spare):
    order, look = Pipe.order, "sfglab.fleet.decoder.node.Watchdog.check"
    if spare:
        monkeypatch.setattr(
            Pipe, "order", lambda pipe, **said: order(pipe, **said) if pipe.pid > 1 else None
        )
    monkeypatch.setattr(look, lambda _, pid: "it was stopped" if pid == 1 else "")
    async with decoding(sim) as it:
        await it.offer("go2", "h264")
        await asyncio.sleep(5)  # it may take 10 s to start
        assert ([pipe.pid for pipe in it.pool], await it.let_end()) == ([1, 2], ["RUNNING"])
        assert "it was stopped" in caplog.text


async def test_a_decoder_that_is_told_to_end_as_something_happens_ends(sim, monkeypatch):
    monkeypatch.setattr(Pipe, "order", lambda *_, **__: None)  # so that a time-out of its runs
    async with decoding(sim) as it:
        await it.offer("go2", "h264")
        it.pool[0].says("opened")
        it.task.cancel()
        assert (await asyncio.wait({it.task}, timeout=5))[0]


async def test_whoever_saw_a_killed_pipeline_waits_for_the_stream_and_who_comes_back_for_what_is_newer(
    sim,
):
    async with decoding(sim) as it:
        it.viewer.close()
        await it.offer("go2", "h264")
        viewer = it.node.create_subscription(IMAGE, LOCAL)
        await asyncio.sleep(1)
        it.pool[0].says("ended", status=-9)
        await asyncio.sleep(5)
        viewer.close()
        await asyncio.sleep(3)
        it.pool[1].says("statistics", **asdict(Statistics(newest=70)))
        await it.let_end()
        it.node.create_subscription(IMAGE, LOCAL)
        await asyncio.sleep(1)
        assert [pipe.stream.after for pipe in it.pool] == [-1, sys.maxsize, 70]


@pytest.mark.parametrize(("replay", "topic"), [(True, f"{STREAM}_replay"), (False, "")])
async def test_a_pipeline_is_told_of_a_replay_unless_that_is_switched_off(sim, replay, topic):
    async with decoding(sim, replay=replay) as it:
        await it.offer("go2", "h264")
        assert [pipe.stream.replay_topic for pipe in it.pool] == [topic]


async def test_a_decoder_that_starts_anew_resumes_what_somebody_watches(sim):
    async with decoding(sim) as it:
        await asyncio.sleep(0.5)
        await it.offer("go2", "h264")
        assert [pipe.stream.after for pipe in it.pool] == [sys.maxsize]


async def test_a_clock_that_is_set_back_keeps_no_stream_waiting(sim, monkeypatch):
    async with decoding(sim) as it:
        await it.offer("go2", "h264")
        it.pool[0].says("ended", status=-9)
        await asyncio.sleep(0.05)
        now_ns = SimClock.now_ns
        monkeypatch.setattr(SimClock, "now_ns", lambda clock: now_ns(clock) - 10**17)
        assert (await it.let_end(), len(it.pool)) == (["RUNNING"], 2)


def passed(way, *transforms):
    """The children that pass a gate."""
    cdr = way(tf(*transforms))
    return [] if cdr is None else [child for _, child in pairs(cdr)]


@pytest.mark.parametrize(
    "pair",
    [
        *("odom base_link", "map //base_link", "map go2", "map go2/odom", "base_link evil/arm"),
        *("map evil/" + "x" * MAX_FRAME, "x" * 999 + " evil/x"),
    ],
    ids=lambda pair: pair[:30],
)
def test_a_frame_of_others_that_could_mean_one_of_the_agents_stays_outside(pair, caplog):
    gate = TransformGate(GO2)
    evil = gate.inward("evil's router")
    for number in range(3):
        others = ("map", "evil/base"), ("earth", "map"), (f"parent{number}", "evil/other")
        assert passed(evil, pair.split(), *others) == [
            "evil/base",
            "map",
        ]
    first, second = [record.message for record in caplog.records]
    assert ("evil's router" in first, len(first) < 1000) == (True, True)
    assert "given the parent frame 'parent0' of 'evil/other', allowed: " in second


def test_a_frame_that_two_move_is_the_firsts_until_that_one_has_gone_and_both_are_named(caplog):
    gate = TransformGate(GO2)
    first, second = gate.inward("h/1"), gate.inward("h/2")
    for pair in (("map", "spot/odom"), ("earth", "map")):
        assert (passed(first, pair), passed(second, pair)) == ([pair[1]], [])
    assert all("h/1" in record.message and "h/2" in record.message for record in caplog.records)
    assert gate.keep_owners(frozenset({"h/2"})), "somebody else waits for them"
    assert passed(second, ("map", "spot/odom")) == ["spot/odom"]
    passed(gate.outward, ("earth", "world"))
    assert passed(second, ("earth", "world")) == [], "the agent's own nodes place it"
    assert "go2 itself" in caplog.text


def test_claims_of_frames_are_bounded_for_each_claimant():
    claims = frames.FrameClaims()
    for number in range(frames.MAX_CLAIMS):
        assert not claims.claim(f"frame{number}", "evil")
    assert "evil has 1000" in claims.claim("one_more", "evil")
    assert not claims.claim("one_more", "go2")


async def test_a_static_transform_that_was_refused_is_read_again_when_its_rival_has_gone(
    sim, caplog
):
    node, router = behind_router(sim, "go2")
    async with (
        sim.node("one", host="pc") as one,
        sim.node("two", host="pc") as two,
        beside(router.run()),
    ):
        heard = node.create_subscription(TF_TYPE, "/tf_static", qos=LATCHED)
        rival = one.create_publisher(TF_TYPE, "/tf_static", LATCHED)
        rival.publish_raw(tf(("earth", "map")))
        await heard.take(10)
        two.create_publisher(TF_TYPE, "/tf_static", LATCHED).publish_raw(tf(("world", "map")))
        await asyncio.sleep(5)
        assert "frames that no other publishes" in caplog.text
        rival.close()
        assert (await heard.take(20)).transforms[0].header.frame_id == "world"


# --- Heartbeats in another agent's name, two agents of one name, and invented agents.

SPOOFS = {
    "a later start": {"incarnation": 2**63 - 1},
    "an earlier start": {"incarnation": 1},
    "the same start": {},
    "another revision": {"revision": 2**32 - 1},
    "a short period": {"period_s": 0.05},
}


def life(spoof, times_s):
    """go2 beats once a second, and answers, until it dies after 60 s: events, counts, alarms."""
    world, alarms, events, asked_s = World(), {}, [], {}
    world.registry = Registry("station", timing=TIMING, on_alarm=alarms.__setitem__)
    for step in range(800):
        at_s, alive = step / 4, step < 240
        names = world.call("due", at_s)
        if at_s in times_s:
            names += world.hear(at_s, b"evil", **{"period_s": 60.0, **spoof})
        if alive and step % 4 == 0:
            names += world.hear(at_s, b"real")
        for query in list(world.outstanding):
            if alive:
                names += world.answer(at_s, len(world.asked) - query)
            elif at_s >= asked_s.setdefault(query, at_s) + 2:
                names += world.fail(at_s, len(world.asked) - query)
        events += [(at_s, name) for name in names if name not in ("QUERY", "ABANDON")]
    return events, world.registry.counts, alarms


@pytest.mark.parametrize("spoof", SPOOFS.values(), ids=SPOOFS)
@pytest.mark.parametrize(
    "times_s",
    [{0.0}, {5.5, 5.75}, {n / 2 for n in range(400)}],
    ids=["once", "twice", "often"],
)
def test_spoofed_heartbeats_hide_neither_an_agent_nor_its_death_and_two_that_go_on_are_reported(
    spoof, times_s
):
    told, counts, alarms = life(spoof, times_s)
    assert [event for _, event in told] == ["DISCOVERED", "LOST"]
    assert 60 < told[1][0] <= 85
    twins, often = alarms.get(("twins", "go2"), ""), len(times_s) > 2
    said = "two publishers send heartbeats of agent 'go2'", b"evil".hex(), b"real".hex()
    assert [part in twins for part in said] == 3 * [often]
    assert (counts["twins"] > 50) is often
    assert counts["asked"] < 60, "who was refused is not asked about at every beat"


def test_two_agents_of_one_name_say_so_themselves_and_a_restart_is_none():
    alarms = {}
    registry = Registry("go2", timing=TIMING, on_alarm=alarms.__setitem__)
    mine = (BEAT, b"mine")
    anew = (replace(BEAT, incarnation=8), b"mine anew")
    # At the restart, a heartbeat from before comes late.
    for second, heard in enumerate([mine, mine, anew, mine, anew, anew]):
        registry.heard(*heard, now_ns=second * S)
    assert registry.counts["twins"] == 0
    for second in range(6, 9):
        for heard in (anew, (BEAT, b"other")):
            registry.heard(*heard, now_ns=second * S)
    assert registry.counts["twins"] > 0
    assert any(b"mine anew".hex() in said and b"other".hex() in said for said in alarms.values())


@pytest.mark.parametrize(("made_up", "published"), [(127, False), (480, True)])
async def test_a_real_agent_is_discovered_at_once_beside_made_up_ones(sim, made_up, published):
    """A limit of 128 queries of services leaves a place; published descriptions need none."""
    found = asyncio.Event()
    settings = DiscoverySettings(agent="pc", use_published_descriptions=published)
    async with (
        sim.node("discoverer", host="pc") as node,
        sim.node("evil", host="evil") as evil,
        sim.node("status", host="go2") as real,
    ):
        discoverer = AgentDiscoverer(node, settings, on_event=lambda _: found.set())
        qos = replace(LATCHED, depth=1000)
        shouts = [evil.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), qos) for _ in range(50)]
        for number in range(made_up):
            beat = replace(BEAT, agent=f"x{number}y", period_s=60.0)
            shouts[number % 50].publish(beat.to_message(0))
        provider = StatusProvider(real, StatusSettings(agent="go2", publish_description=published))
        async with beside(discoverer.run()):
            await asyncio.sleep(3)
            assert len(discoverer.states) == made_up
            started_s = asyncio.get_running_loop().time()
            async with beside(provider.run()), asyncio.timeout(30):
                await found.wait()
            assert asyncio.get_running_loop().time() - started_s < 0.1


@pytest.mark.live
async def test_nothing_is_kept_of_a_message_that_is_larger_than_its_process_takes(free_domains):
    one, other = free_domains(2)
    qos, small = QoSProfile(depth=10), {"max_sample_bytes": 1 << 20}
    async with (
        Node("big", domain_id=one, interface="lo") as sender,
        Node("small", domain_id=other, external_domain_id=one, interface="lo", **small) as taker,
    ):
        heard = taker.create_subscription("std_msgs/msg/String", "/x", qos=qos)
        publisher = sender.create_publisher("std_msgs/msg/String", "/x", qos)
        await publisher.wait_for_subscriptions(1, 30)
        for size in (4 << 20, 1000, 20 << 20, 2000):
            publisher.publish(default_message("std_msgs/msg/String", data="x" * size))
        assert [len((await heard.take(30)).data) for _ in range(2)] == [1000, 2000]


async def test_a_description_that_is_too_large_is_not_read(sim, monkeypatch, caplog):
    read = []

    def reading(cdr, type_):
        read.append(len(cdr))
        return deserialize(cdr, type_)

    for module in ("sfglab.bus.service", "sfglab.fleet.discovery.published"):
        monkeypatch.setattr(f"{module}.deserialize", reading)
    software = tuple("x" * 200 for _ in range(1000))
    settings = StatusSettings(agent="go2", description=AgentDescription(software=software))
    async with sim.node("discoverer", host="pc") as node, sim.node("status", host="go2") as real:
        discoverer = AgentDiscoverer(node, DiscoverySettings(agent="pc"))
        async with beside(discoverer.run(), StatusProvider(real, settings).run()):
            await asyncio.sleep(10)
    assert discoverer.counts["failed"] > 1
    dropped = [m for m in caplog.messages if "dropped a description" in m and "malformed" in m]
    assert len(dropped) == 1
    assert max(read, default=0) < 1000
