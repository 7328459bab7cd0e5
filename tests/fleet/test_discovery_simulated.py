"""Status provider and discoverer on the simulated bus: faults, default waits, hours; and as a process."""

import asyncio
from collections import Counter
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace

import pytest
from test_discovery_registry import BEAT

from sfglab.bus.sim import LinkModel, run_simulated
from sfglab.component import beside
from sfglab.fleet.discovery import listener
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.status import heartbeat
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.node import StatusProvider
from sfglab.messages import serialize, service_type
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


class Fake:
    """An agent that beats when it is told, and answers when it may; it notes queries in a list."""

    def __init__(self, node, agent, asked) -> None:
        self.node, self.agent, self.asked, self.may_answer = node, agent, asked, asyncio.Event()
        self.metadata = AgentDescription().to_message(agent, incarnation=7, revision=0, stamp_ns=0)
        topic = heartbeat.heartbeat_topic()
        self.publisher = node.create_publisher(heartbeat.AGENT_HEARTBEAT, topic, LATCHED)

    def say(self) -> None:
        beat = replace(BEAT, agent=self.agent, period_s=30.0)
        self.publisher.publish(beat.to_message(0))

    def serve(self) -> None:
        service = heartbeat.metadata_service(self.agent)
        self.node.create_service(heartbeat.GET_METADATA, service, self.answer)

    async def answer(self, _request):
        self.asked.append(self.agent)
        await self.may_answer.wait()
        response = service_type(heartbeat.GET_METADATA).response
        return response(success=True, message="", metadata=self.metadata)


async def sleep_until(time_s: float) -> None:
    await asyncio.sleep(time_s - asyncio.get_running_loop().time())


async def test_an_agent_returns_after_a_partition_restarts_after_an_end_and_is_forgotten(sim):
    """With the default waits: 15.5 s of silence, and ten minutes."""
    async with discoverer(sim) as (found, events):
        async with status(sim, "go2"):
            await sleep_until(31)  # it beat at 30 s, in the steady state
            sim.host("go2").is_connected = False
            await sleep_until(61)
            sim.host("go2").is_connected = True
            await sleep_until(120)
        assert found.status().counts["asked"] == 1
        await sleep_until(140)
        async with status(sim, "go2"):
            await sleep_until(141)
        await sleep_until(740)
        assert [agent.state.name for agent in found.status().agents] == ["LOST"]
        await sleep_until(760)
        assert found.status().agents == ()
    times_s, _, kinds = zip(*events, strict=True)
    assert kinds == ("DISCOVERED", "LOST", "RETURNED", "LOST", "RESTARTED", "LOST")
    assert times_s[:2] == pytest.approx((0, 45.5), abs=0.1)
    assert 61 < times_s[2] < 75


async def test_a_description_that_comes_after_its_query_failed_answers_the_next_one(sim):
    async with discoverer(sim) as (found, events), sim.node("fake", host="go2") as node:
        fake = Fake(node, "go2", [])
        whole = serialize(replace(BEAT, agent="aaaa").to_message(0))
        fake.publisher.publish_raw(whole.replace(b"aaaa", b"\xff\xfeaa"))
        await sleep_until(1)
        fake.say()
        await sleep_until(6)
        assert found.status().counts["dropped_malformed"] == 1
        topic = heartbeat.metadata_topic()
        publisher = node.create_publisher(heartbeat.AGENT_METADATA, topic, LATCHED)
        publisher.publish(fake.metadata)
        await sleep_until(40)
        assert [event for _, _, event in events] == ["DISCOVERED"]


@pytest.mark.parametrize("published", [False, True])
@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_everybody_in_a_fleet_finds_everybody_else_with_one_query_each(loss, published):
    names = [f"robot{n}" for n in range(6)]

    async def scenario(world):
        async with AsyncExitStack() as stack:
            for name in names:
                await stack.enter_async_context(status(world, name, published=published))
            finding = [discoverer(world, n, use_published_descriptions=published) for n in names]
            found = [await stack.enter_async_context(each) for each in finding]
            await sleep_until(60)
            for own, (node, events) in zip(names, found, strict=True):
                discovered = [agent for _, agent, event in events if event == "DISCOVERED"]
                assert sorted([*discovered, own]) == names
                counts = node.status().counts
                assert counts["asked"] == counts["answered"] + counts.get("failed", 0)
                if not loss:
                    assert (counts["asked"], counts.get("published", 0)) == (5, 5 * published)
                    assert events[-1][0] < 0.5

    run_simulated(scenario, seed=3, link=LinkModel(loss=loss), limit_s=200)


async def test_queries_are_limited_and_untried_agents_go_first(sim):
    settings = {"max_queries": 2, "use_published_descriptions": False}
    async with discoverer(sim, **settings) as (found, events), sim.node("x", host="x") as node:
        asked = []
        fakes = [Fake(node, f"agent{number}x", asked) for number in range(6)]
        for fake in fakes:
            for _ in range(3):  # heartbeats while a query is outstanding ask nothing
                fake.say()
            await asyncio.sleep(0.1 if asked else 4)  # the first service is found late
            fake.serve()
            await asyncio.sleep(0.1)
        assert (found.status().counts["asked"], len(asked)) == (6, 2)
        await sleep_until(9)
        assert asked[:6] == [fake.agent for fake in fakes]
        for fake in fakes:
            fake.may_answer.set()
        await sleep_until(30)
        assert Counter(event for _, _, event in events) == {"DISCOVERED": 6}
        counts = found.status().counts
        assert counts["asked"] == len(asked) == counts["failed"] + 6, "one at a time"


async def test_a_service_is_called_where_no_description_is_published_or_two_disagree(sim):
    async with (
        discoverer(sim) as (found, events),
        sim.node("evil", host="evil") as evil,
        status(sim, "robot") as provider,
        status(sim, "silent", published=False),
    ):
        topic = heartbeat.metadata_topic()
        lies = evil.create_publisher(heartbeat.AGENT_METADATA, topic, LATCHED)
        await sleep_until(5)
        (soon_s, *first), (later_s, *second) = events
        assert (first, second) == (["robot", "DISCOVERED"], ["silent", "DISCOVERED"])
        assert (soon_s < 0.1, 0.5 <= later_s < 0.6) == (True, True)
        for _ in range(2):
            provider.update(AgentDescription(software=("new",)))
            await sleep_until(asyncio.get_running_loop().time() + 5)
            assert events[-1][1:] == ("robot", "UPDATED")
            assert found.status().counts["published"] == 2, "two of them disagree, so it is asked"
            false = AgentDescription(software=("false",))
            lies.publish(false.to_message("robot", incarnation=2**63, revision=9, stamp_ns=0))
        assert len(events) == 4


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
