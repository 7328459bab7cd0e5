"""The simulated world itself: time, hosts and pulled cables; `conformance` shows that nodes behave."""

import asyncio
import hashlib
import os
import subprocess
import sys
from collections import Counter

import pytest
from bus_messages import STRING, text
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab import bus
from sfglab.bus.sim import Costs, DeadlockError, TimeLimitError, run_simulated
from sfglab.qos import LATCHED, Durability, QoSProfile

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
    connected = dict.fromkeys(("h0", "h1", "h2"), True)
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
            host = chance.choice(list(connected))
            connected[host] = not connected[host]
            world.connect(host, connected=connected[host])
        await asyncio.sleep(chance.choice([0, 0.0001, 0.01, 0.7]))
    for host in connected:
        world.connect(host)
    await asyncio.sleep(60)
    return nodes, publishers, subscriptions


def digest_of(seed):
    events = []

    def main(world):
        return change(world, note=lambda event: events.append((world.now_ns, event)))

    run_simulated(main, seed=seed, latency_s=0.002)
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
        (None, DeadlockError, r"no event is scheduled.*Inbox\._wait.*somebody in Event\.wait"),
        (1.0, TimeLimitError, r"not end within 60 s of virtual time; waiting tasks: .*Event\.wait"),
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


# --- Hosts, domains, processes.


async def test_nodes_meet_only_in_one_domain_and_a_loopback_domain_is_its_hosts_own(sim):
    places = ["a0network", "b0network", "a0host", "b0host", "b1network"]
    nodes = [sim.node("n", host=p[0], domain_id=int(p[1]), reach=p[2:]) for p in places]
    publishers = [node.create_publisher(STRING, "/t") for node in nodes]
    for node in nodes:
        node.create_subscription(STRING, "/t")
    await asyncio.sleep(1)
    assert [publisher.get_subscription_count() for publisher in publishers] == [2, 2, 1, 1, 1]


@pytest.mark.parametrize("sim", [{"latency_s": 0.01}], indirect=True)
async def test_a_sample_takes_the_latency_of_both_links_and_nothing_on_its_own_host(sim):
    sim.host("far", 0.03)
    publisher = sim.node("here", host="near").create_publisher(STRING, "/t")
    readers = [
        sim.node(host, host=host).create_subscription(STRING, "/t") for host in ("near", "far")
    ]
    await asyncio.sleep(1)
    publisher.publish(text("x"))
    infos = [(await reader.take_with_info())[1] for reader in readers]
    delays_ms = [(info.received_timestamp_ns - info.source_timestamp_ns) / MS for info in infos]
    assert delays_ms == [0.1, 40.2]


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


# --- Faults.


async def test_a_short_cut_delays_and_a_long_one_is_a_loss_and_a_return(sim):
    here, there = (sim.node(name, host=name, lease_s=4.0) for name in ("here", "there"))
    deep = QoSProfile(depth=100, durability=Durability.TRANSIENT_LOCAL)
    publisher = here.create_publisher(STRING, "/t", deep)
    volatile, latched = (there.create_subscription(STRING, "/t", qos=q) for q in (100, deep))
    events = []
    there.graph.watch(
        "rt/t", PUBLISHER, lambda event: events.append((type(event), sim.now_ns / 1e9))
    )
    await asyncio.sleep(1)
    sim.connect("here", connected=False)
    publisher.publish(text("short"))
    await asyncio.sleep(3)
    assert len(events) == 1
    sim.connect("here")
    assert (await volatile.take()).data == (await latched.take()).data == "short"
    assert 4 <= sim.now_ns / 1e9 <= 4.2

    sim.connect("here", connected=False)
    cut_s = sim.now_ns / 1e9
    publisher.publish(text("long"))
    await asyncio.sleep(10)
    assert (publisher.get_subscription_count(), volatile.get_publisher_count()) == (0, 0)
    assert here.graph.subscriptions("/t") == ()
    sim.connect("here")
    await publisher.wait_for_subscriptions(2, 10)
    assert await take_all(latched, 1) == ["short", "long"]  # a reader that was lost is a new one
    assert await take_all(volatile, 1) == []
    kinds, times_s = zip(*events, strict=True)
    assert kinds == (bus.EndpointAdded, bus.EndpointRemoved, bus.EndpointAdded)
    assert times_s[1] - cut_s == pytest.approx(4)


# --- After all changes the nodes know the same.


@given(st.integers(1, 2**31), st.booleans())
@settings(max_examples=20, deadline=None)
def test_after_all_changes_and_pulled_cables_the_nodes_know_and_match_the_same(seed, faults):
    async def main(world):
        nodes, publishers, subscriptions = await change(world, faults=faults)
        topics = Counter(subscription.topic_name for subscription in subscriptions)
        for publisher in publishers:
            assert publisher.get_subscription_count() == topics[publisher.topic_name]
        for node in nodes:
            known = {endpoint.gid for endpoint in node.graph.endpoints()}
            assert known == {end.gid for end in (*publishers, *subscriptions)}

    run_simulated(main, seed=seed)
