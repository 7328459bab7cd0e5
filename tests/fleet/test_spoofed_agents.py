"""Heartbeats in somebody's name, two of one name, and made-up agents: what discovery makes of them."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import pytest
from test_discovery_registry import BEAT, TIMING, S

from sfglab.bus import Node
from sfglab.component import beside
from sfglab.fleet.discovery.lifecycle import ANNOUNCEMENTS, Action
from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoverySettings
from sfglab.fleet.discovery.registry import Registry
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, heartbeat_topic
from sfglab.fleet.status.node import StatusProvider, StatusSettings
from sfglab.messages import default_message, deserialize
from sfglab.qos import LATCHED, QoSProfile

HUGE = 2**63 - 1
SPOOFS = {
    "a later start": {"incarnation": HUGE},
    "an earlier start": {"incarnation": 1},
    "the same start": {},
    "another revision": {"revision": 2**32 - 1},
}


def life(spoof: dict, times_s, dies_s: float, until_s: float):
    """A world in which go2 beats once a second until it dies, and answers: events, counts, alarms."""
    alarms, told, failing = {}, [], {}
    registry = Registry("station", timing=TIMING, on_alarm=alarms.__setitem__)

    def carry_out(orders, now_ns):
        for order in orders:
            if order.action in ANNOUNCEMENTS:
                told.append((now_ns / S, order.event))
            elif order.action is Action.ABANDON:
                failing.pop(order.query, None)
            elif now_ns / S < dies_s:
                answer = SimpleNamespace(agent="go2", incarnation=7, revision=0)
                carry_out(registry.answered("go2", order.query, answer, now_ns=now_ns), now_ns)
            else:
                failing[order.query] = now_ns + 2 * S

    for step in range(round(until_s * 4)):
        now_ns = step * S // 4
        carry_out(registry.due(now_ns), now_ns)
        for query in [query for query, at_ns in failing.items() if at_ns <= now_ns]:
            del failing[query]
            carry_out(registry.failed("go2", query, now_ns=now_ns), now_ns)
        if now_ns / S in times_s:
            spoofed = replace(BEAT, period_s=60.0, **spoof)
            carry_out(registry.heard(spoofed, b"evil", now_ns=now_ns), now_ns)
        if step % 4 == 0 and now_ns / S < dies_s:
            carry_out(registry.heard(BEAT, b"real", now_ns=now_ns), now_ns)
    return told, registry.counts, alarms


@pytest.mark.parametrize("spoof", SPOOFS.values(), ids=SPOOFS)
@pytest.mark.parametrize(
    "times_s", [{0.0}, {5.5}, {n / 2 for n in range(400)}], ids=["first", "later", "often"]
)
def test_spoofed_heartbeats_hide_neither_an_agent_nor_its_death_and_two_that_go_on_are_reported(spoof, times_s):
    told, counts, alarms = life(spoof, times_s, dies_s=60, until_s=200)
    assert [event for _, event in told] == ["DISCOVERED", "LOST"]
    assert 60 < told[1][0] <= 85
    said = [sentence for sentence in alarms.values() if "two speak for agent 'go2'" in sentence]
    assert (len(said), counts["twins"] > 50) == ((1, True) if len(times_s) > 1 else (0, False))
    assert all(gid.hex() in sentence for gid in (b"evil", b"real") for sentence in said)
    assert counts["asked"] < 60, "who was refused is not asked about at every beat"


def test_two_agents_of_one_name_say_so_themselves_and_a_restart_is_none():
    alarms = []
    registry = Registry("go2", timing=TIMING, on_alarm=lambda _, sentence: alarms.append(sentence))
    for second in range(3):
        registry.heard(BEAT, b"mine", now_ns=second * S)
    for second in range(3, 6):
        registry.heard(replace(BEAT, incarnation=8), b"mine anew", now_ns=second * S)
    assert alarms == []
    for second in range(6, 9):
        registry.heard(replace(BEAT, incarnation=8), b"mine anew", now_ns=second * S)
        registry.heard(replace(BEAT, incarnation=5), b"other", now_ns=second * S + 1)
    assert any(b"mine anew".hex() in said and b"other".hex() in said for said in alarms)
    assert registry.counts["twins"] > 0


@pytest.mark.parametrize("sim", [{"seed": 1, "limit_s": 60}], indirect=True)
@pytest.mark.parametrize("publishers", [1, 50])
async def test_a_real_agent_is_discovered_beside_a_thousand_made_up_ones(sim, publishers):
    found = asyncio.Event()
    loop = asyncio.get_running_loop()
    async with sim.node("discoverer", host="pc") as node, sim.node("evil", host="evil") as evil:
        discoverer = AgentDiscoverer(node, DiscoverySettings(agent="pc"), on_event=lambda _: found.set())
        qos = replace(LATCHED, depth=1000)
        made_up = [evil.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), qos) for _ in range(publishers)]

        async def shout():
            while True:
                for n in range(1000):
                    beat = replace(BEAT, agent=f"x{n}y", incarnation=n, period_s=5.0)
                    made_up[n % publishers].publish(beat.to_message(0))
                await asyncio.sleep(2)

        async with beside(discoverer.run(), shout()), sim.node("status", host="go2") as real:
            await asyncio.sleep(1)
            started_s = loop.time()
            async with beside(StatusProvider(real, StatusSettings(agent="go2")).run()):
                await asyncio.wait_for(found.wait(), 30)
        assert loop.time() - started_s < 5
        assert len(discoverer.status().agents) <= 500


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
            message = default_message("std_msgs/msg/String")
            message.data = "x" * size
            publisher.publish(message)
        assert [len((await heard.take(30)).data) for _ in range(2)] == [1000, 2000]


@pytest.mark.parametrize("sim", [{"seed": 1, "limit_s": 60}], indirect=True)
async def test_a_description_that_is_too_large_is_not_read(sim, monkeypatch):
    read = []

    def reading(cdr, type_):
        if len(cdr) > 1000:
            read.append(type_)
        return deserialize(cdr, type_)

    monkeypatch.setattr("sfglab.bus.service.deserialize", reading)
    software = tuple("x" * 200 for _ in range(1000))
    settings = StatusSettings(agent="go2", description=AgentDescription(software=software))
    async with sim.node("discoverer", host="pc") as node, sim.node("status", host="go2") as real:
        discoverer = AgentDiscoverer(node, DiscoverySettings(agent="pc"))
        async with beside(discoverer.run(), StatusProvider(real, settings).run()):
            await asyncio.sleep(10)
        assert (discoverer.status().counts["failed"] > 1, read) == (True, [])
