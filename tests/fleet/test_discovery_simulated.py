"""Status provider and discoverer on the simulated bus: faults, default waits and hours."""

import asyncio
from collections import Counter
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from test_discovery_registry import BEAT

from sfglab.component import beside
from sfglab.fleet.discovery import listener
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer, QueryLimit
from sfglab.fleet.status import heartbeat
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.node import StatusProvider
from sfglab.messages import serialize
from sfglab.qos import LATCHED

sim = pytest.fixture(lambda: {"seed": 1, "limit_s": 800})


@asynccontextmanager
async def status(world, agent, *, published=True):
    """An agent's status provider on a host of its own."""
    async with world.node("status", host=agent) as node:
        settings = StatusSettings(agent=agent, publish_description=published)
        provider = StatusProvider(node, settings)
        async with beside(provider.run()):
            yield provider


@asynccontextmanager
async def discoverer(world, agent="station", **settings):
    """A discoverer on a host of its own; yields it and (time in seconds, agent, event) of all its events."""
    async with world.node("discoverer", host=agent) as node:
        events = []

        def note(news):
            events.append((round(asyncio.get_running_loop().time(), 2), news.agent, news.event))

        found = AgentDiscoverer(node, DiscoverySettings(agent=agent, **settings), on_event=note)
        async with beside(found.run()) as (task,):
            yield found, events
            assert not task.done(), task.exception()


async def sleep_until(time_s):
    await asyncio.sleep(time_s - asyncio.get_running_loop().time())


async def test_an_agent_returns_after_a_partition_restarts_after_an_end_and_is_forgotten(sim):
    """With the default waits: 15.5 s of silence, and ten minutes."""
    async with discoverer(sim) as (found, events):
        async with status(sim, "go2"):
            await sleep_until(31)  # it beat at 30 s, in the steady state
            sim.connect("go2", connected=False)
            await sleep_until(61)
            sim.connect("go2")
            await sleep_until(120)
        assert found.counts["asked"] == 1
        await sleep_until(140)
        async with status(sim, "go2"):
            await sleep_until(141)
        await sleep_until(740)
        assert [state.name for state in found.states.values()] == ["LOST"]
        await sleep_until(760)
        assert found.states == {}
    times_s, _, kinds = zip(*events, strict=True)
    assert kinds == ("DISCOVERED", "LOST", "RETURNED", "LOST", "RESTARTED", "LOST")
    assert times_s[:2] == pytest.approx((0, 45.5), abs=0.1)
    assert 61 < times_s[2] < 75


async def test_bytes_are_no_heartbeat_and_a_description_that_comes_late_answers_the_next_query(sim):
    async with discoverer(sim) as (found, events), sim.node("fake", host="go2") as node:
        beats = node.create_publisher(
            heartbeat.AGENT_HEARTBEAT, heartbeat.heartbeat_topic(), LATCHED
        )
        whole = serialize(replace(BEAT, agent="aaaa").to_message(0))
        beats.publish_raw(whole.replace(b"aaaa", b"\xff\xfeaa"))
        await sleep_until(1)
        beats.publish(replace(BEAT, period_s=30.0).to_message(0))
        await sleep_until(6)
        assert found.counts["dropped_malformed"] == 1
        topic = heartbeat.metadata_topic()
        publisher = node.create_publisher(heartbeat.AGENT_METADATA, topic, LATCHED)
        publisher.publish(
            AgentDescription().to_message("go2", incarnation=7, revision=0, stamp_ns=0)
        )
        await sleep_until(40)
        assert [event for _, _, event in events] == ["DISCOVERED"]


async def test_queries_are_limited_untried_agents_go_first_and_a_cancelled_one_returns_its_place():
    limit, began = QueryLimit(2), []

    async def query(failures, number):
        async with limit.place(failures, number):
            began.append(number)
            await asyncio.sleep(0.01)

    waiting = [(0, 1), (0, 2), (3, 3), (1, 4), (0, 5), (0, 6)]
    queries = [asyncio.create_task(query(*each)) for each in waiting]
    await asyncio.sleep(0)
    assert began == [1, 2]
    queries[0].cancel()
    queries[5].cancel()
    await asyncio.gather(*queries, return_exceptions=True)
    assert began == [1, 2, 5, 4, 3]


async def test_a_service_is_called_where_two_published_descriptions_disagree(sim):
    async with (
        discoverer(sim) as (found, events),
        sim.node("evil", host="evil") as evil,
        status(sim, "robot") as provider,
    ):
        topic = heartbeat.metadata_topic()
        lies = evil.create_publisher(heartbeat.AGENT_METADATA, topic, LATCHED)
        await sleep_until(5)
        false = AgentDescription(software=("false",))
        lies.publish(false.to_message("robot", incarnation=2**63, revision=9, stamp_ns=0))
        provider.update(AgentDescription(software=("new",)))
        await sleep_until(10)
        assert [event for _, _, event in events] == ["DISCOVERED", "UPDATED"]
        assert found.counts["published"] == 1


async def test_a_consumer_that_comes_after_many_events_still_hears_of_everybody(sim, monkeypatch):
    monkeypatch.setattr("sfglab.fleet.discovery.node.HISTORY", 200)
    monkeypatch.setattr(
        "sfglab.fleet.discovery.node.DISCOVERY_QOS", replace(listener.DISCOVERY_QOS, depth=200)
    )
    async with (
        discoverer(sim) as (_, events),
        status(sim, "quiet"),
        status(sim, "busy") as provider,
        sim.node("late", host="station") as late,
    ):
        for number in range(210):
            await asyncio.sleep(0.1)
            provider.update(AgentDescription(software=(str(number),)))
        await asyncio.sleep(1)
        kinds = Counter(event[1:] for event in events)
        assert kinds["busy", "UPDATED"] > 200
        assert kinds["quiet", "DISCOVERED"] == 2, "repeated before it was pushed out"
        changes = listener.agent_changes(late, listener.discovery_topic("station"))
        agents = {}
        while agents.get("busy") != ["209"]:
            change = await anext(changes)
            agents[change.agent] = change.metadata.software
        assert set(agents) == {"quiet", "busy"}
        await changes.aclose()
