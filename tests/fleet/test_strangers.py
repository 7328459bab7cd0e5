"""What strangers say of themselves, and candidates that come late: one test for each way in that was found."""

import asyncio
import sys
from contextlib import asynccontextmanager
from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest
from cameras import FFMPEG, IMAGE, LOCAL, STREAM, behind_router, everything
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
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, discovery_topic
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.discovery.registry import Registry
from sfglab.fleet.discovery.validation import MAX_STREAMS, validated_metadata
from sfglab.fleet.router import frames
from sfglab.fleet.router.frames import MAX_FRAME, TF_TYPE, TransformGate
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, Heartbeat, heartbeat_topic
from sfglab.fleet.status.node import StatusProvider
from sfglab.messages import default_message, deserialize, service_type
from sfglab.qos import LATCHED, QoSProfile

METADATA, PC = "sfglab_interfaces/srv/GetMetadata", DiscoverySettings(agent="pc")
DEEP = QoSProfile(depth=1000)
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
            "another agent's name",
        ),
        ("camera_info_topic", "/local/go2/camera_front/color/camera_info", "global scope"),
        ("topic", "/global/spot/camera_front/color/ffmpeg", "another agent's name"),
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
    assert ([route.source_topic for route in routes], "another stream's" in str(error)) == (
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
            self.owner(self, {"is": "opened"})

    def signal(self, number):
        self.owner(self, {"is": "ended", "status": -number})

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
async def decoding(world):
    """A decoder whose topic somebody wants; yields what it started, and ways to offer and to let end."""
    async with world.node("decoder", host="pc") as node:
        node.create_subscription(IMAGE, LOCAL)
        pool = Pool()
        decoder = AgentDecoder(node, pool, advertise_unused_topics=False)

        async def offer(agent, *codecs):
            stream = {"source_topic": STREAM, "source_type": FFMPEG, "local_topic": LOCAL}
            decoder.offer(agent, [Route(agent=agent, codec=codec, **stream) for codec in codecs])
            await asyncio.sleep(0.5)

        async def let_end():
            for pipe in [pipe for pipe in pool if pipe.closing]:
                pipe.owner(pipe, {"is": "closed"})
            await asyncio.sleep(0.5)
            return [status.state for status in decoder.status()]

        async with beside(decoder.run()) as (task,):
            yield pool, offer, let_end
            assert not task.done(), task.exception()


@pytest.mark.parametrize("back", ["h264", "hevc"], ids=["as it was", "changed"])
async def test_a_stream_that_returns_while_its_old_pipeline_still_leaves_is_decoded_again(
    sim, back
):
    async with decoding(sim) as (pool, offer, let_end):
        for codecs in (["h264"], [], [], [back]):
            await offer("go2", *codecs)
        assert await let_end() == ["RUNNING"]
        assert [pipe.stream.codec for pipe in pool] == ["h264", back]


async def test_who_came_second_is_decoded_when_the_first_has_gone(sim, caplog):
    async with decoding(sim) as (pool, offer, let_end):
        for agent, *codecs in (
            ("evil", "h264"),
            ("go2", "h264"),
            ("spot", "h264"),
            ("spot",),
            ("evil",),
        ):
            await offer(agent, *codecs)
        assert "offered by evil already" in caplog.text
        assert await let_end() == ["RUNNING"]
        assert [pipe.stream.agent for pipe in pool] == ["evil", "go2"]
        await offer("go2")
        assert await let_end() == []


@pytest.mark.parametrize("spare", [False, True], ids=["which had begun", "a spare that never does"])
async def test_a_pipeline_process_that_hangs_is_replaced(sim, caplog, monkeypatch, spare):
    order, look = Pipe.order, "sfglab.fleet.decoder.node.Watchdog.check"
    if spare:
        monkeypatch.setattr(
            Pipe, "order", lambda pipe, **said: order(pipe, **said) if pipe.pid > 1 else None
        )
    monkeypatch.setattr(look, lambda _, pid: "it was stopped" if pid == 1 else "")
    async with decoding(sim) as (pool, offer, let_end):
        await offer("go2", "h264")
        await asyncio.sleep(5)  # it may take 10 s to start
        assert ([pipe.pid for pipe in pool], await let_end()) == ([1, 2], ["RUNNING"])
        assert "it was stopped" in caplog.text


async def test_a_decoder_that_is_told_to_end_as_something_happens_ends(sim, monkeypatch):
    monkeypatch.setattr(Pipe, "order", lambda *_, **__: None)  # so that a time-out of its runs
    async with sim.node("decoder", host="pc") as node:
        node.create_subscription(IMAGE, LOCAL)
        decoder = AgentDecoder(node, pool := Pool(), advertise_unused_topics=False)
        stream = {"source_topic": STREAM, "source_type": FFMPEG, "local_topic": LOCAL}
        decoder.offer("go2", [Route(agent="go2", codec="h264", **stream)])
        async with beside(decoder.run()) as (task,):
            await asyncio.sleep(0.5)
            pool[0].owner(pool[0], {"is": "opened"})
            task.cancel()
            assert (await asyncio.wait({task}, timeout=5))[0]


async def test_whoever_saw_a_killed_pipeline_waits_for_the_stream_and_who_comes_back_for_what_is_newer(
    sim,
):
    async with sim.node("decoder", host="pc") as node:
        pool, stream = Pool(), {"source_topic": STREAM, "source_type": FFMPEG, "local_topic": LOCAL}
        decoder = AgentDecoder(node, pool, advertise_unused_topics=False)
        async with beside(decoder.run()):
            decoder.offer("go2", [Route(agent="go2", codec="h264", **stream)])
            await asyncio.sleep(1)
            viewer = node.create_subscription(IMAGE, LOCAL)
            await asyncio.sleep(1)
            pool[0].owner(pool[0], {"is": "ended", "status": -9})
            await asyncio.sleep(5)
            viewer.close()
            await asyncio.sleep(3)
            assert pool[1].closing
            pool[1].owner(pool[1], {"is": "statistics", **asdict(Statistics(newest=70))})
            pool[1].owner(pool[1], {"is": "closed"})
            await asyncio.sleep(1)
            node.create_subscription(IMAGE, LOCAL)
            await asyncio.sleep(1)
            assert [pipe.stream.after for pipe in pool] == [-1, sys.maxsize, 70]


async def test_a_decoder_that_starts_anew_resumes_what_somebody_watches(sim):
    async with decoding(sim) as (pool, offer, _):
        await asyncio.sleep(0.5)
        await offer("go2", "h264")
        assert [pipe.stream.after for pipe in pool] == [sys.maxsize]


async def test_a_clock_that_is_set_back_keeps_no_stream_waiting(sim, monkeypatch):
    async with decoding(sim) as (pool, offer, let_end):
        await offer("go2", "h264")
        pool[0].owner(pool[0], {"is": "ended", "status": -9})
        await asyncio.sleep(0.05)
        now_ns = SimClock.now_ns
        monkeypatch.setattr(SimClock, "now_ns", lambda clock: now_ns(clock) - 10**17)
        assert (await let_end(), len(pool)) == (["RUNNING"], 2)


async def test_an_evil_agent_changes_nothing_in_anothers_local_topics_and_tree(sim):
    """It says, in every way that D_0 has, what is another agent's to say; only what is its own arrives."""
    own, event = "/local/pc/camera_front/color/image_raw", discovery_topic("pc")
    node, router = behind_router(sim, "pc")
    async with sim.node("evil", host="evil") as evil:
        described = several(
            "/global/evil/camera_front/color/ffmpeg", "/global/evil/camera_rear/color/ffmpeg"
        )
        described.agent, described.incarnation, described.revision = "evil", 9, 0
        described.sensors[0].streams[0].decoded_topic = own
        response = service_type(METADATA).response(success=True, message="", metadata=described)
        evil.create_service(METADATA, "/global/evil/get_metadata", lambda _: response)
        said = {own: IMAGE, event: DISCOVERY_EVENT, "/global/evil/news": IMAGE}
        publishers = [evil.create_publisher(type_, topic, LATCHED) for topic, type_ in said.items()]
        beats = [evil.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), LATCHED) for _ in "ab"]
        trees = [evil.create_publisher(TF_TYPE, topic, LATCHED) for topic in ("/tf", "/tf_static")]
        frames_ = [
            ("odom", "base_link"),
            ("map", "odom"),
            ("map", "pc/odom"),
            ("evil/a", "base_link"),
        ]
        heard = {
            topic: node.create_subscription(type_, topic, qos=DEEP) for topic, type_ in said.items()
        }
        moved = [
            node.create_subscription(TF_TYPE, topic, qos=DEEP) for topic in ("/tf", "/tf_static")
        ]
        mine = node.create_publisher(TF_TYPE, "/tf", LATCHED)
        pool = Pool()
        decoder, discoverer = (
            AgentDecoder(node, pool, advertise_unused_topics=False),
            AgentDiscoverer(node, PC),
        )
        async with beside(router.run(), discoverer.run(), decoder.run(event)):
            for second in range(30):
                mine.publish_raw(tf(("odom", "base_link")))
                for publisher, type_ in zip(publishers, said.values(), strict=True):
                    publisher.publish(default_message(type_))
                for agent, beat in zip(("evil", "pc"), beats, strict=True):
                    fields = {
                        "incarnation": 9,
                        "revision": 0,
                        "phase": 1,
                        "period_s": 1.0,
                        "version": "",
                    }
                    beat.publish(Heartbeat(agent=agent, **fields).to_message(second * 10**9))
                for tree in trees:
                    for pair in (*frames_, ("map", "evil/base")):
                        tree.publish_raw(tf(pair))
                await asyncio.sleep(1)
        got = {topic: await everything(subscription) for topic, subscription in heard.items()}
        assert (got[own], len(got["/global/evil/news"]) > 20) == ([], True)
        assert {message.agent for message in got[event]} == {"evil"}, (
            "its discoverer's, of the real heartbeats"
        )
        (status,) = decoder.status()
        assert status.local_topic == "/local/evil/camera_rear/color/image_raw"
        parts = [
            part
            for tree in moved
            for heard_ in await everything(tree)
            for part in heard_.transforms
        ]
        edges = [(part.header.frame_id, part.child_frame_id) for part in parts]
        assert set(edges) == {("odom", "base_link"), ("map", "evil/base")}
        assert edges.count(("odom", "base_link")) == 30


def passed(way, *transforms):
    """The children that pass a gate."""
    cdr = way(tf(*transforms))
    return [] if cdr is None else [child for _, child in pairs(cdr)]


@pytest.mark.parametrize(
    "pair",
    [
        *(
            "odom base_link",
            "map base_link",
            "map /base_link",
            "map //base_link",
            "map go2",
            "map go2/odom",
        ),
        *("base_link evil/arm", "map evil/" + "x" * MAX_FRAME, "x" * 999 + " evil/x"),
    ],
    ids=lambda pair: pair[:30],
)
def test_a_frame_of_others_that_could_mean_one_of_the_agents_stays_outside(pair, caplog):
    gate = TransformGate(GO2)
    evil = gate.inward("evil's router")
    for _ in range(3):
        assert passed(evil, pair.split(), ("map", "evil/base"), ("earth", "map")) == [
            "evil/base",
            "map",
        ]
    (said,) = [record.message for record in caplog.records]
    assert (gate.clashed, "evil's router" in said, len(said) < 1000) == (3, True, True)


def test_a_frame_that_two_move_is_the_firsts_until_that_one_has_gone_and_both_are_named(caplog):
    gate = TransformGate(GO2)
    first, second = gate.inward("h/1"), gate.inward("h/2")
    for pair in (("map", "spot/odom"), ("map", "go2/base"), ("earth", "map")):
        assert (passed(first, pair), passed(second, pair)) == ([pair[1]], [])
    assert all("h/1" in record.message and "h/2" in record.message for record in caplog.records)
    assert gate.keep_owners(frozenset({"h/2"})), "somebody else waits for them"
    assert passed(second, ("map", "spot/odom")) == ["spot/odom"]
    passed(gate.outward, ("earth", "world"))
    assert passed(second, ("earth", "world")) == [], "the agent's own nodes place it"
    assert ("go2 itself" in caplog.text, gate.clashed) == (True, 5)
    claims = frames.FrameClaims()
    for number in range(frames.MAX_CLAIMS):
        claims.claim(f"frame{number}", "evil")
    for frame in ("one_more", "x" * (MAX_FRAME + 1)):
        with pytest.raises(frames.FrameClashError, match="evil has 1000"):
            claims.claim(frame, "evil")
    claims.claim("one_more", "go2")


async def test_a_static_transform_that_was_refused_is_read_again_when_its_rival_has_gone(sim):
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
        assert router.status.clashed == 1
        rival.close()
        assert (await heard.take(20)).transforms[0].header.frame_id == "world"


# --- Heartbeats in somebody's name, two of one name, and made-up agents.

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
    answer = SimpleNamespace(agent="go2", incarnation=7, revision=0)

    def note(at_s, names):
        for query in list(world.outstanding):
            if at_s < 60:
                names += world.end("answered", at_s, world.asked[query - 1], answer)
            elif at_s >= asked_s.setdefault(query, at_s) + 2:
                world.end("failed", at_s, world.asked[query - 1])
        events.extend((at_s, name) for name in names if name not in ("QUERY", "ABANDON"))

    for step in range(800):
        at_s = step / 4
        note(at_s, world.call("due", at_s))
        if at_s in times_s:
            note(at_s, world.hear(at_s, b"evil", **{"period_s": 60.0, **spoof}))
        if step % 4 == 0 and at_s < 60:
            note(at_s, world.hear(at_s, b"real"))
    return events, world.registry.counts, alarms


@pytest.mark.parametrize("spoof", SPOOFS.values(), ids=SPOOFS)
@pytest.mark.parametrize(
    "times_s",
    [{0.0}, {5.5}, {5.5, 5.75}, {n / 2 for n in range(400)}],
    ids=["once", "later", "twice", "often"],
)
def test_spoofed_heartbeats_hide_neither_an_agent_nor_its_death_and_two_that_go_on_are_reported(
    spoof, times_s
):
    told, counts, alarms = life(spoof, times_s)
    assert [event for _, event in told] == ["DISCOVERED", "LOST"]
    assert 60 < told[1][0] <= 85
    said = [
        sentence
        for sentence in alarms.values()
        if "two publishers send heartbeats of agent 'go2'" in sentence
    ]
    assert (len(said), counts["twins"] > 50) == ((1, True) if len(times_s) > 2 else (0, False))
    assert all(gid.hex() in sentence for gid in (b"evil", b"real") for sentence in said)
    assert counts["asked"] < 60, "who was refused is not asked about at every beat"


def test_two_agents_of_one_name_say_so_themselves_and_a_restart_is_none():
    alarms = {}
    registry = Registry("go2", timing=TIMING, on_alarm=alarms.__setitem__)
    later = replace(BEAT, incarnation=8)
    for second, *heard in (
        *((n, (BEAT, b"mine")) for n in range(3)),
        (3, (later, b"mine anew"), (BEAT, b"mine"), (later, b"mine anew")),  # one was late
        *((n, (later, b"mine anew")) for n in range(4, 6)),
        *((n, (later, b"mine anew"), (BEAT, b"other")) for n in range(6, 9)),
    ):
        for beat, gid in heard:
            registry.heard(beat, gid, now_ns=second * S)
        assert second > 5 or registry.counts["twins"] == 0
    assert any(b"mine anew".hex() in said and b"other".hex() in said for said in alarms.values())
    assert registry.counts["twins"] > 0


@pytest.mark.parametrize(("made_up", "published"), [(96, False), (127, False), (480, True)])
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
            assert len(discoverer.status().agents) == made_up
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


async def test_a_description_that_is_too_large_is_not_read(sim, monkeypatch):
    read = []

    def reading(cdr, type_):
        if len(cdr) > 1000:
            read.append(type_)
        return deserialize(cdr, type_)

    for module in ("sfglab.bus.service", "sfglab.fleet.discovery.published"):
        monkeypatch.setattr(f"{module}.deserialize", reading)
    software = tuple("x" * 200 for _ in range(1000))
    settings = StatusSettings(agent="go2", description=AgentDescription(software=software))
    async with sim.node("discoverer", host="pc") as node, sim.node("status", host="go2") as real:
        discoverer = AgentDiscoverer(node, PC)
        async with beside(discoverer.run(), StatusProvider(real, settings).run()):
            await asyncio.sleep(10)
        counts = discoverer.status().counts
        assert (counts["dropped_description_malformed"], counts["failed"] > 1, read) == (
            1,
            True,
            [],
        )
