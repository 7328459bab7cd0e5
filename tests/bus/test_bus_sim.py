"""The simulated world itself: time, chance, links and faults; `conformance` shows that nodes behave."""

import asyncio
import hashlib
import os
import subprocess
import sys
from collections import Counter
from itertools import pairwise

import pytest
from bus_messages import STRING, connected, text
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab import bus
from sfglab.bus.sim import Costs, DeadlockError, LinkModel, TimeLimitError, World, run_simulated
from sfglab.bus.sim.network import frame_bytes
from sfglab.qos import LATCHED, SENSOR_DATA, Durability, History, QoSProfile

MS = 1_000_000
PUBLISHER = bus.EndpointKind.PUBLISHER


async def take_all(subscription, wait_s=5.0):
    got = []
    try:
        async with asyncio.timeout(wait_s):
            while True:
                got.append((await subscription.take()).data)
    except TimeoutError:
        return got


# --- One seed, one run.


async def change(world, *, faults=True, note=lambda *_: None):
    """Make and close endpoints, publish and pull cables at random; return nodes and what is open."""
    chance = world.random
    nodes = [world.node(f"n{i}", host=f"h{i % 3}", lease_s=1.0) for i in range(4)]
    for node in nodes:
        node.graph.listen(note)
    publishers, subscriptions = [], []
    for number in range(60):
        node, topic = chance.choice(nodes), chance.choice(["/a", "/b"])
        step = chance.choice(["talk", "talk", "hear", "hear", "end", *["fail"] * faults])
        if step == "talk":
            publishers.append(node.create_publisher(STRING, topic, LATCHED))
            publishers[-1].publish(text(number))
        elif step == "hear":
            subscriptions.append(node.create_subscription(STRING, topic, note, LATCHED))
        elif step == "end" and (ends := chance.choice([publishers, subscriptions])):
            ends.pop(chance.randrange(len(ends))).close()
        elif step == "fail":
            host = chance.choice(list(world.hosts.values()))
            host.is_connected = not host.is_connected
        await asyncio.sleep(chance.choice([0, 0.0001, 0.01, 0.7]))
    for host in world.hosts.values():
        host.is_connected = True
    await asyncio.sleep(60)
    return nodes, publishers, subscriptions


def digest_of(seed):
    events = []

    def main(world):
        return change(world, note=lambda event: events.append((world.now_ns, event)))

    run_simulated(main, seed=seed, link=LinkModel(latency_s=0.002, loss=0.1, rate_bps=1e7))
    assert len(events) > 100
    return hashlib.blake2b(repr(events).encode()).hexdigest()


def test_the_same_seed_gives_the_same_events_in_every_process():
    here = digest_of(7)
    assert digest_of(8) != here
    code = "import test_bus_sim as t; print(t.digest_of(7))"
    environment = {"PYTHONHASHSEED": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    argv = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(argv, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == here, done.stderr


# --- Virtual time.


@pytest.mark.parametrize(
    ("period_s", "error", "said"),
    [
        (None, DeadlockError, r"nothing is scheduled.*Inbox\._wait.*somebody in Event\.wait"),
        (1.0, TimeLimitError, r"not done after 60 s of virtual time; waiting are .*Event\.wait"),
    ],
)
def test_a_world_that_comes_to_a_halt_or_to_its_limit_ends_and_says_who_waits(
    period_s, error, said
):
    async def main(world):
        node = world.node("here")
        if period_s:
            node.create_timer(period_s, lambda: None)
        other = asyncio.create_task(asyncio.Event().wait(), name="somebody")
        await node.create_subscription(STRING, "/t").take()
        other.cancel()

    with pytest.raises(error, match=said):
        run_simulated(main, limit_s=60)


async def test_a_thread_is_not_reproducible_and_refused(sim):
    with pytest.raises(bus.BusError, match="a thread"):
        await asyncio.to_thread(print)


async def test_a_world_needs_its_own_loop():
    with pytest.raises(bus.BusError, match="use it inside run_simulated"):
        World()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda w: w.node("a", reach="moon"), "allowed: network, host"),
        (lambda w: w.node("a", domain_id=233), "allowed ids are 0 to 232"),
        (lambda _: LinkModel(latency_s=-1), "latency_s: given -1, allowed: from 0"),
        (lambda _: LinkModel(loss=1), "loss: given 1, allowed: from 0, below 1"),
        (lambda _: LinkModel(rate_bps=0), "rate_bps: given 0, allowed: rates above 0"),
        (lambda _: Costs(message_s=-1), "message_s: given -1"),
    ],
)
async def test_impossible_worlds_say_why(sim, wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong(sim)


# --- Hosts, domains, processes.


async def test_nodes_meet_only_in_one_domain_and_a_loopback_domain_is_its_hosts_own(sim):
    places = ["a0network", "b0network", "a0host", "b0host", "b1network"]
    nodes = [sim.node("n", host=p[0], domain_id=int(p[1]), reach=p[2:]) for p in places]
    publishers = [node.create_publisher(STRING, "/t") for node in nodes]
    for node in nodes:
        node.create_subscription(STRING, "/t")
    await asyncio.sleep(1)
    assert [publisher.get_subscription_count() for publisher in publishers] == [2, 2, 1, 1, 1]


@pytest.mark.parametrize("sim", [{"link": LinkModel(latency_s=0.01)}], indirect=True)
async def test_a_sample_takes_the_latency_of_both_links_and_nothing_on_its_own_host(sim):
    sim.host("far", LinkModel(latency_s=0.03))
    publisher = sim.node("here", host="near").create_publisher(STRING, "/t")
    readers = [
        sim.node(host, host=host).create_subscription(STRING, "/t") for host in ("near", "far")
    ]
    await asyncio.sleep(1)
    publisher.publish(text("x"))
    infos = [(await reader.take_with_info())[1] for reader in readers]
    delays_ms = [(info.received_timestamp_ns - info.source_timestamp_ns) / MS for info in infos]
    assert delays_ms == [0.1, 40.2]


@pytest.mark.parametrize("sim", [{"link": LinkModel(rate_bps=1e6)}], indirect=True)
async def test_a_limited_rate_spaces_samples_and_lets_them_queue(sim):
    qos = QoSProfile(reliability=SENSOR_DATA.reliability, depth=99)
    publisher, reader = await connected(sim.node("a", host="a"), sim.node("b", host="b"), qos)
    await asyncio.sleep(1)
    for _ in range(10):
        publisher.publish(text("x" * 1000))
    times = [(await reader.take_with_info())[1].received_timestamp_ns for _ in range(10)]
    bits = 8 * (1012 + 14 + 20 + 8 + 20 + 12 + 24)
    assert {later - earlier for earlier, later in pairwise(times)} == {bits * 1000}


@pytest.mark.parametrize(
    ("cdr_bytes", "reliable", "captured"),
    [
        (72, False, 170),
        (112, True, 242),
        (1012, True, 1142),
        (3012, True, 3210),
        (20_012, True, 20_722),
        (100_012, True, 103_314),
    ],
)
def test_a_sample_is_as_large_as_captured_of_cyclone_dds_within_one_per_cent(
    cdr_bytes, reliable, captured
):
    assert frame_bytes(cdr_bytes, reliable=reliable) == pytest.approx(captured, rel=0.01)


SOME = range(41, 120)  # of 400, of which two links of 10 % lose 19 %


@pytest.mark.parametrize(
    ("qos", "rate_bps", "missing"),
    [
        (SENSOR_DATA, None, SOME),
        (QoSProfile(history=History.KEEP_ALL), None, range(1)),
        (QoSProfile(depth=1000), 1e7, range(1)),
        # A repeat takes 100 ms, in which 100 samples are written: ten have lost what to repeat.
        (QoSProfile(depth=10), None, SOME),
    ],
)
def test_best_effort_notices_losses_and_reliable_repairs_them_while_the_history_lasts(
    qos, rate_bps, missing
):
    async def main(world):
        sender, receiver = world.node("a", host="a"), world.node("b", host="b")
        publisher = sender.create_publisher(STRING, "/t", qos)
        deep = QoSProfile(reliability=qos.reliability, history=History.KEEP_ALL)
        reader = receiver.create_subscription(STRING, "/t", qos=deep)
        await publisher.wait_for_subscriptions()
        await asyncio.sleep(30)
        for number in range(400):
            publisher.publish(text(number))
            await asyncio.sleep(0.001)
        return [int(number) for number in await take_all(reader, 30)], reader.lost

    got, lost = run_simulated(main, seed=5, link=LinkModel(loss=0.1, rate_bps=rate_bps))
    assert got == sorted(set(got))
    assert 400 - len(got) in missing
    assert 400 - len(got) - lost in range(8)  # losses at both ends cannot be noticed


@pytest.mark.parametrize("sim", [{"costs": Costs(message_s=0.01)}], indirect=True)
async def test_messages_wait_for_a_process_that_is_busy(sim):
    heard_ms = {"shared": [], "alone": []}
    publisher = sim.node("talker", process="shared").create_publisher(STRING, "/t", 100)
    for name, process in (("a", "shared"), ("b", "shared"), ("c", "alone")):
        sim.node(name, process=process).create_subscription(
            STRING,
            "/t",
            lambda _, to=heard_ms[process]: to.append((sim.now_ns - start_ns) / MS),
            100,
        )
    await publisher.wait_for_subscriptions(3)
    await asyncio.sleep(1)
    start_ns = sim.now_ns
    for _ in range(3):
        publisher.publish(text("x"))
    await asyncio.sleep(1)
    assert heard_ms["shared"] == [10.1, 20.1, 30.1, 40.1, 50.1, 60.1]
    assert heard_ms["alone"] == [10.1, 20.1, 30.1]


async def test_a_sample_older_than_its_lifespan_does_not_reach_a_late_joiner(sim):
    qos = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=5, lifespan_ns=10**9)
    publisher = sim.node("a").create_publisher(STRING, "/t", qos)
    publisher.publish(text("old"))
    await asyncio.sleep(2)
    publisher.publish(text("new"))
    assert await take_all(sim.node("b").create_subscription(STRING, "/t", qos=LATCHED), 1) == [
        "new"
    ]


# --- Faults.


async def test_a_short_cut_delays_a_long_one_is_a_loss_and_a_return_and_a_crash_a_loss(sim):
    here, there = (sim.node(name, host=name, lease_s=4.0) for name in ("here", "there"))
    deep = QoSProfile(depth=100, durability=Durability.TRANSIENT_LOCAL)
    publisher = here.create_publisher(STRING, "/t", deep)
    volatile, latched = (there.create_subscription(STRING, "/t", qos=q) for q in (100, deep))
    events = []
    there.graph.watch(
        "rt/t", PUBLISHER, lambda event: events.append((type(event), sim.now_ns / 1e9))
    )
    await asyncio.sleep(1)
    cable = sim.host("here")
    cable.is_connected = False
    publisher.publish(text("short"))
    await asyncio.sleep(3)
    assert len(events) == 1
    cable.is_connected = True
    assert (await volatile.take()).data == (await latched.take()).data == "short"
    assert 4 <= sim.now_ns / 1e9 <= 4.2

    cable.is_connected = False
    cut_s = sim.now_ns / 1e9
    publisher.publish(text("long"))
    await asyncio.sleep(10)
    assert (publisher.get_subscription_count(), volatile.get_publisher_count()) == (0, 0)
    assert here.graph.subscriptions("/t") == ()
    cable.is_connected = True
    await publisher.wait_for_subscriptions(2, 10)
    assert await take_all(latched, 1) == ["short", "long"]  # a reader that was lost is a new one
    assert await take_all(volatile, 1) == []

    await asyncio.sleep(60)
    crash_s = sim.now_ns / 1e9
    here.crash()
    here.crash()
    with pytest.raises(bus.ClosedError):
        publisher.publish(text("from beyond"))
    await asyncio.sleep(10)
    assert volatile.get_publisher_count() == 0
    after_cut_s, after_crash_s = (at_s for kind, at_s in events if kind is bus.EndpointRemoved)
    assert after_cut_s - cut_s == pytest.approx(4)
    assert 2 < after_crash_s - crash_s <= 4


# --- After all changes the nodes know the same.


@given(st.integers(1, 2**31), st.sampled_from([0.0, 0.3]), st.booleans())
@settings(max_examples=20, deadline=None)
def test_after_all_changes_and_pulled_cables_the_nodes_know_and_match_the_same(seed, loss, faults):
    async def main(world):
        nodes, publishers, subscriptions = await change(world, faults=faults)
        topics = Counter(subscription.topic_name for subscription in subscriptions)
        for publisher in publishers:
            assert publisher.get_subscription_count() == topics[publisher.topic_name]
        for node in nodes:
            known = {endpoint.gid for endpoint in node.graph.endpoints()}
            assert known == {end.gid for end in (*publishers, *subscriptions)}

    run_simulated(main, seed=seed, link=LinkModel(loss=loss))


# --- Many readers.
