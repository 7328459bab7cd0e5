"""Status and discovery on the simulated bus: faults, default waits, and hours in a second; and as a process."""

import asyncio
from collections import Counter
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace

import pytest
from test_discovery_registry import BEAT
from waiting import DEADLINE_S, process

from sfglab.bus import Node
from sfglab.bus.api import RawEndpoint
from sfglab.bus.sim import LinkModel, run_simulated
from sfglab.component import beside
from sfglab.fleet.discovery import listener
from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoveryConfig, DiscoverySettings
from sfglab.fleet.status import heartbeat
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.node import StatusProvider, StatusSettings
from sfglab.messages import default_message, serialize, service_type
from sfglab.qos import LATCHED

sim = pytest.fixture(lambda: {"seed": 1, "limit_s": 700})


@asynccontextmanager
async def status(world, agent, *, offers=False):
    """An agent's status provider on a host of its own."""
    async with (
        world.node("status", host=agent) as node,
        beside(StatusProvider(node, StatusSettings(agent=agent, offers=offers)).run()),
    ):
        yield


@asynccontextmanager
async def discoverer(world, agent="station", *, on_move=None, **settings):
    """A discoverer on a host of its own; yields it and (time in seconds, agent, event) of all its events."""
    async with world.node("discoverer", host=agent) as node:
        events = []

        def note(news):
            events.append((round(asyncio.get_running_loop().time(), 2), news.agent, news.event))

        told = DiscoverySettings(agent=agent, **settings)
        found = AgentDiscoverer(node, told, on_event=note, on_move=on_move)
        async with beside(found.run()) as (task,):
            yield found, events
            assert not task.done(), task.exception()


class Fake:
    """An agent that says and answers what it is told."""

    def __init__(self, node, agent="go2", *, mute=False) -> None:
        self.beat, self.may_answer = replace(BEAT, agent=agent, period_s=30.0), asyncio.Event()
        if not mute:
            self.may_answer.set()
        self.asked = 0
        self.publisher = node.create_publisher(
            heartbeat.AGENT_HEARTBEAT, heartbeat.heartbeat_topic(), LATCHED
        )
        node.create_service(heartbeat.GET_METADATA, heartbeat.metadata_service(agent), self.answer)

    def say(self) -> None:
        self.publisher.publish(self.beat.to_message(0))

    async def answer(self, _request):
        self.asked += 1
        await self.may_answer.wait()
        response = default_message(service_type(heartbeat.GET_METADATA).response)
        response.success, response.metadata.agent = True, self.beat.agent
        response.metadata.incarnation, response.metadata.revision = (
            self.beat.incarnation,
            self.beat.revision,
        )
        return response


async def sleep_until(time_s: float) -> None:
    await asyncio.sleep(time_s - asyncio.get_running_loop().time())


async def test_a_pulled_cable_is_lost_and_its_end_returned_with_the_default_waits(sim):
    async with discoverer(sim) as (found, events), status(sim, "go2"):
        await sleep_until(31)  # it beat at 30 s, in the steady state
        sim.host("go2").is_connected = False
        await sleep_until(61)
        sim.host("go2").is_connected = True
        await sleep_until(120)
        assert [event for _, _, event in events] == ["DISCOVERED", "LOST", "RETURNED"]
        discovered, lost, returned = (time_s for time_s, _, _ in events)
        assert discovered < 0.2
        assert lost == pytest.approx(45.5, abs=0.1), (
            "three periods of 5 s and the slack after the last one"
        )
        assert 61 < returned < 75
        assert found.status().counts["asked"] == 1


@pytest.mark.parametrize("offers", [False, True])
@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_everybody_in_a_fleet_finds_everybody_else_with_one_query_each(loss, offers):
    names = [f"robot{n}" for n in range(6)]

    async def scenario(world):
        async with AsyncExitStack() as stack:
            for name in names:
                await stack.enter_async_context(status(world, name, offers=offers))
            found = [
                await stack.enter_async_context(discoverer(world, name, offers=offers))
                for name in names
            ]
            await sleep_until(60)
            for own, (node, events) in zip(names, found, strict=True):
                discovered = sorted(agent for _, agent, event in events if event == "DISCOVERED")
                assert discovered == [name for name in names if name != own]
                counts = node.status().counts
                assert counts["dropped_own"] > 0
                assert counts["asked"] == counts["answered"] + counts.get("failed", 0)
                if not loss:
                    assert counts["asked"] == 5
                    assert counts.get("offered", 0) == 5 * offers
                    assert max(time_s for time_s, _, _ in events) < 0.5

    run_simulated(scenario, seed=3, link=LinkModel(loss=loss), limit_s=200)


async def test_an_agent_whose_service_is_found_late_is_asked_once(sim):
    async with discoverer(sim) as (found, events), sim.node("status", host="go2") as node:
        publisher = node.create_publisher(
            heartbeat.AGENT_HEARTBEAT, heartbeat.heartbeat_topic(), LATCHED
        )
        publisher.publish(replace(BEAT, period_s=30.0).to_message(0))
        await sleep_until(4)
        fake = Fake(node, mute=True)
        await sleep_until(5.5)
        fake.may_answer.set()
        await sleep_until(10)
        assert [event for _, _, event in events] == ["DISCOVERED"]
        counts = found.status().counts
        assert (counts["asked"], counts.get("failed", 0)) == (1, 0)


async def test_an_agent_that_never_answers_is_asked_again_and_not_more_often_than_is_counted(sim):
    moves = []
    async with (
        discoverer(sim, on_move=moves.append) as (found, events),
        sim.node("fake", host="go2") as node,
    ):
        fake = Fake(node, mute=True)
        for _ in range(3):  # heartbeats while a query is outstanding ask nothing
            fake.say()
        await sleep_until(20)
        assert found.status().agents[0].failures >= 4
        assert events == []
        fake.may_answer.set()
        await sleep_until(60)
        assert [event for _, _, event in events] == ["DISCOVERED"]
        failed = [move for move in moves if move.given.name == "FAILED"]
        assert found.status().counts["asked"] == fake.asked == len(failed) + 1


async def test_at_most_so_many_agents_are_asked_at_once_and_all_in_the_end(sim):
    async with (
        discoverer(sim, max_queries=2) as (found, events),
        sim.node("fakes", host="x") as node,
    ):
        fakes = [Fake(node, f"agent{n}x", mute=True) for n in range(6)]
        for fake in fakes:
            fake.say()
        await sleep_until(1)
        assert (found.status().counts["asked"], sum(fake.asked for fake in fakes)) == (6, 2)
        for fake in fakes:
            fake.may_answer.set()
        await sleep_until(2)
        assert Counter(event for _, _, event in events) == {"DISCOVERED": 6}


async def test_bytes_that_are_no_heartbeat_are_counted_and_harmless(sim):
    async with discoverer(sim) as (found, events), sim.node("fake", host="go2") as node:
        broken = bytearray(serialize(replace(BEAT, agent="aaaa").to_message(0)))
        broken[broken.index(b"aaaa") : broken.index(b"aaaa") + 2] = b"\xff\xfe"  # not UTF-8
        topic = f"rt{heartbeat.heartbeat_topic()}"
        raw = RawEndpoint(
            dds_topic=topic, type=heartbeat.AGENT_HEARTBEAT, qos=LATCHED, user_data=b""
        )
        node.open_forwarder(node).open_writer(raw).write(bytes(broken), 0)
        Fake(node).say()
        await sleep_until(5)
        assert found.status().counts["dropped_malformed"] == 1
        assert [event for _, _, event in events] == ["DISCOVERED"]


async def test_who_offers_nothing_or_is_spoken_for_by_two_is_asked_and_what_changes_is_offered_anew(
    sim,
):
    async with discoverer(sim, offers=True) as (found, events), AsyncExitStack() as stack:
        node, evil = [
            await stack.enter_async_context(sim.node("status", host=name)) for name in ("a", "evil")
        ]
        lies = evil.create_publisher(heartbeat.AGENT_METADATA, heartbeat.metadata_topic(), LATCHED)
        provider = StatusProvider(node, StatusSettings(agent="robot", offers=True))
        await stack.enter_async_context(beside(provider.run()))
        await stack.enter_async_context(status(sim, "silent"))
        await sleep_until(5)
        (soon_s, *first), (later_s, *second) = events
        assert (first, second) == (["robot", "DISCOVERED"], ["silent", "DISCOVERED"])
        assert soon_s < 0.1
        assert 0.5 <= later_s < 0.6, "asked when no offer has come"
        assert found.status().counts["offered"] == 1
        provider.update(AgentDescription(software=("new",)))
        await sleep_until(10)
        assert (events[-1][1:], found.status().counts["offered"]) == (("robot", "UPDATED"), 2)
        false = AgentDescription(software=("false",))
        lies.publish(false.to_message("robot", incarnation=2**63, revision=9, stamp_ns=0))
        await sleep_until(15)
        provider.update(AgentDescription(software=("newer",)))
        await sleep_until(20)
        counts = found.status().counts
        assert (events[-1][1:], counts["event_updated"], counts["offered"]) == (
            ("robot", "UPDATED"),
            2,
            2,
        )


async def test_an_agent_that_is_gone_is_lost_its_next_start_restarted_and_it_is_forgotten_after_ten_minutes(
    sim,
):
    async with discoverer(sim) as (found, events):
        for begins_s in (0, 40):
            await sleep_until(begins_s)
            async with status(sim, "go2"):
                await sleep_until(begins_s + 5)
        await sleep_until(640)
        assert [a.state.name for a in found.status().agents] == ["LOST"]
        await sleep_until(660)
        assert found.status().agents == ()
        assert [event for _, _, event in events] == ["DISCOVERED", "LOST", "RESTARTED", "LOST"]


async def test_a_consumer_that_comes_after_a_thousand_events_still_hears_of_everybody(sim):
    async with (
        discoverer(sim) as (found, events),
        status(sim, "quiet"),
        sim.node("status", host="busy") as node,
    ):
        provider = StatusProvider(node, StatusSettings(agent="busy"))
        async with beside(provider.run()):
            for number in range(1100):
                await asyncio.sleep(0.1)
                provider.update(AgentDescription(software=(str(number),)))
            await asyncio.sleep(1)
            kinds = Counter((agent, event) for _, agent, event in events)
            assert kinds["busy", "UPDATED"] > listener.HISTORY
            assert kinds["quiet", "DISCOVERED"] == 2, "repeated before it was pushed out"
            async with sim.node("late", host="station") as late:
                topic = listener.discovery_topic("station")
                heard = late.create_subscription(
                    listener.DISCOVERY_EVENT, topic, qos=listener.DISCOVERY_QOS
                )
                agents = listener.KnownAgents()
                for _ in range(listener.HISTORY):
                    message, info = await heard.take_with_info(timeout_s=5)
                    agents.feed(message, info.publisher_gid, now_ns=0)
                assert set(agents.agents) == {"quiet", "busy"}
                assert agents.agents["busy"].software == ["1099"]
        assert found.status().counts["event_discovered"] == 3


@pytest.mark.live
async def test_as_a_process_it_reports_events_moves_and_what_it_knows(address):
    config = DiscoveryConfig(
        address=address, settings=DiscoverySettings(agent="station"), report_moves=True
    )
    async with Node("there", **address.options()) as there:
        Fake(there).say()
        async with process("sfglab.fleet.discovery.node", config) as child:
            reports = []
            child.on_report = reports.append
            await child.expect("event", timeout_s=DEADLINE_S)
            child.order(report=True)
            status = await child.expect("status", timeout_s=DEADLINE_S)
    assert child.status == 0
    assert reports[0] == {"is": "ready"}
    first, event = reports[1], next(r for r in reports if r["is"] == "event")
    assert (first["before"], first["given"], first["actions"]) == ("UNKNOWN", "HEARD", ["QUERY"])
    assert (event["agent"], event["event"], event["incarnation"]) == ("go2", "DISCOVERED", 7)
    assert [(a["agent"], a["state"]) for a in status["agents"]] == [("go2", "ACTIVE")]
    assert status["counts"]["asked"] == 1
