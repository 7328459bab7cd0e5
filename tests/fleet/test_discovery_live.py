"""The discoverer on a real bus, with faults as they happen: killed, stopped, mute, slow, false and too many."""

import asyncio
import signal
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from waiting import DEADLINE_S, process, until

from sfglab.component import beside
from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoveryConfig, DiscoverySettings
from sfglab.fleet.discovery.registry import Timing
from sfglab.fleet.status.heartbeat import GET_METADATA, Heartbeat, Schedule, heartbeat_topic, metadata_service
from sfglab.fleet.status.node import StatusConfig, StatusSettings
from sfglab.messages import default_message, serialize, service_type
from sfglab.qos import LATCHED

pytestmark = [pytest.mark.live]
world = pytest.fixture(lambda live: live)

AGENT_HEARTBEAT = "sfglab_interfaces/msg/AgentHeartbeat"
FAST = Schedule(startup_period_s=0.1, steady_period_s=0.1, startup_s=0)
TIMING = Timing(missed=3, slack_ns=500_000_000, backoff_ns=50_000_000, backoff_max_ns=200_000_000)
BEAT = Heartbeat(agent="go2", incarnation=1, revision=0, phase=0, period_s=30.0, version="1")


class Watch:
    """What a discoverer announced and did, in order, to be waited for."""

    def __init__(self) -> None:
        self.events: asyncio.Queue = asyncio.Queue()
        self.moves = []
        self.discoverer = None

    async def event(self, agent="go2", timeout_s=60) -> str:
        async with asyncio.timeout(timeout_s):
            while (news := await self.events.get()).agent != agent:
                pass
        return news.event

    async def count(self, name: str, at_least: int) -> None:
        await until(lambda: self.discoverer.status().counts.get(name, 0) >= at_least)


@asynccontextmanager
async def discovering(node, **settings):
    watch = Watch()
    values = {"agent": "station", "timing": TIMING, "query_timeout_s": 5.0} | settings
    told, hear = DiscoverySettings(**values), watch.events.put_nowait
    watch.discoverer = AgentDiscoverer(node, told, on_event=hear, on_move=watch.moves.append)
    async with beside(watch.discoverer.run()) as (task,):
        yield watch
        assert not task.done(), task.exception()


def status_process(address, schedule=FAST):
    settings = StatusSettings(agent="go2", schedule=schedule)
    return process("sfglab.fleet.status.node", StatusConfig(address=address, settings=settings, detect=False))


class Fake:
    """An agent that says and answers what it is told, and counts how many queries are open at once."""

    def __init__(self, node, beat=BEAT, *, mute=False) -> None:
        self.beat, self.may_answer = beat, asyncio.Event()
        if not mute:
            self.may_answer.set()
        self.asked = self.open = self.most_open = 0
        self.publisher = node.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), LATCHED)
        node.create_service(GET_METADATA, metadata_service(beat.agent), self.answer)

    def say(self, **changes) -> None:
        self.beat = replace(self.beat, **changes)
        self.publisher.publish(self.beat.to_message(0))

    async def answer(self, _request):
        self.asked += 1
        self.open += 1
        self.most_open = max(self.open, self.most_open)
        try:
            await self.may_answer.wait()
            response = default_message(service_type(GET_METADATA).response)
            response.success, response.metadata.agent = True, self.beat.agent
            response.metadata.incarnation = self.beat.incarnation
            response.metadata.revision = self.beat.revision
            return response
        finally:
            self.open -= 1


async def test_a_process_that_is_killed_is_lost_and_the_next_one_restarted(here, address):
    async with discovering(here) as watch:
        async with status_process(address) as child:
            assert await watch.event() == "DISCOVERED"
            child.signal(signal.SIGKILL)
            assert await watch.event() == "LOST"
        async with status_process(address):
            assert await watch.event() == "RESTARTED"


async def test_an_agent_that_never_answers_is_asked_again_and_never_twice_at_a_time(here, there):
    fake = Fake(there, mute=True)
    async with discovering(here, query_timeout_s=0.2) as watch:
        for _ in range(3):  # heartbeats while a query is outstanding ask nothing
            fake.say()
        await watch.count("failed", 4)
        assert watch.discoverer.status().agents[0].failures >= 4
        assert watch.events.empty()
        fake.may_answer.set()
        assert await watch.event() == "DISCOVERED"
    asked = watch.discoverer.status().counts["asked"]
    assert fake.asked <= asked, "not more on the wire than were counted"
    waits = [m for m in watch.moves if m.given.name == "FAILED"]
    assert len(waits) == asked - 1


async def test_at_most_so_many_agents_are_asked_at_once_and_all_in_the_end(here, there):
    fakes = [Fake(there, replace(BEAT, agent=f"agent{n}x"), mute=True) for n in range(6)]
    async with discovering(here, max_queries=2) as watch:
        for fake in fakes:
            fake.say()
        await watch.count("asked", 6)
        await until(lambda: sum(fake.open for fake in fakes) >= 2)
        assert sum(fake.asked for fake in fakes) == 2
        for fake in fakes:
            fake.may_answer.set()
        await watch.count("event_discovered", 6)


async def test_bytes_that_are_no_heartbeat_are_counted_and_harmless(here, there):
    async with discovering(here) as watch:
        fake = Fake(there)
        await fake.publisher.wait_for_subscriptions(timeout_s=60)
        broken = bytearray(serialize(replace(BEAT, agent="aaaa").to_message(0)))
        broken[broken.index(b"aaaa") : broken.index(b"aaaa") + 2] = b"\xff\xfe"  # not UTF-8
        fake.publisher.publish_raw(bytes(broken))
        await watch.count("dropped_malformed", 1)
        fake.say()
        assert await watch.event() == "DISCOVERED"


async def test_as_a_process_it_reports_events_moves_and_what_it_knows(there, address):
    told = DiscoverySettings(agent="station", timing=TIMING)
    config = DiscoveryConfig(address=address, settings=told, report_moves=True)
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
    assert (event["agent"], event["event"], event["incarnation"]) == ("go2", "DISCOVERED", 1)
    assert [(a["agent"], a["state"]) for a in status["agents"]] == [("go2", "ACTIVE")]
    assert status["counts"]["asked"] == 1
