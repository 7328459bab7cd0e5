"""The discoverer on a real bus, with faults as they happen: killed, stopped, mute, slow, false and too many."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from sfglab.bus import Node, ServiceTimeoutError
from sfglab.bus.address import BusAddress
from sfglab.component import argument_of, config_from_argument
from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS, KnownAgents, discovery_topic
from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoveryConfig, DiscoverySettings
from sfglab.fleet.discovery.registry import Timing
from sfglab.fleet.discovery.screening import Limits
from sfglab.fleet.status.heartbeat import GET_METADATA, Heartbeat, Schedule, heartbeat_topic, metadata_service
from sfglab.fleet.status.node import StatusConfig, StatusSettings
from sfglab.messages import default_message, serialize, service_type
from sfglab.qos import LATCHED

pytestmark = [pytest.mark.live]

AGENT_HEARTBEAT = "sfglab_interfaces/msg/AgentHeartbeat"
FAST = Schedule(startup_period_s=0.1, steady_period_s=0.1, startup_s=0)
TIMING = Timing(missed=3, slack_ns=500_000_000, backoff_ns=50_000_000, backoff_max_ns=200_000_000)
BEAT = Heartbeat(agent="go2", incarnation=1, revision=0, phase=0, period_s=30.0, version="1")


@pytest.fixture
def address(domain_id):
    """A DDS domain that nobody uses, so that other test runs on this machine stay apart."""
    return BusAddress(domain_id=domain_id, interface="lo")


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
        async with asyncio.timeout(60):
            while self.discoverer.status().counts.get(name, 0) < at_least:
                await asyncio.sleep(0.01)


@asynccontextmanager
async def discovering(node, **settings):
    watch = Watch()
    values = {"agent": "station", "timing": TIMING, "query_timeout_s": 5.0} | settings
    watch.discoverer = AgentDiscoverer(
        node, DiscoverySettings(**values), on_event=watch.events.put_nowait, on_move=watch.moves.append
    )
    task = asyncio.create_task(watch.discoverer.run())
    try:
        yield watch
        assert not task.done(), task.exception()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


@asynccontextmanager
async def process(module: str, config):
    pipe = asyncio.subprocess.PIPE
    child = await asyncio.create_subprocess_exec(
        sys.executable, "-W", "error", "-m", module, argument_of(config), stdin=pipe, stdout=pipe
    )
    try:
        yield child
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


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


def test_a_process_that_is_killed_is_lost_and_the_next_one_restarted(address):
    async def scenario():
        async with Node("here", **address.options()) as node, discovering(node) as watch:
            async with status_process(address) as child:
                assert await watch.event() == "DISCOVERED"
                child.kill()
                assert await watch.event() == "LOST"
            async with status_process(address):
                assert await watch.event() == "RESTARTED"

    asyncio.run(scenario())


def test_a_process_that_is_stopped_is_lost_and_returns_when_it_goes_on(address):
    async def scenario():
        async with Node("here", **address.options()) as node, discovering(node) as watch:
            async with status_process(address) as child:
                assert await watch.event() == "DISCOVERED"
                child.send_signal(signal.SIGSTOP)
                assert await watch.event() == "LOST"
                child.send_signal(signal.SIGCONT)
                assert await watch.event() == "RETURNED"
            assert watch.discoverer.status().counts["asked"] == 1, "it was known already"

    asyncio.run(scenario())


def test_a_process_that_is_killed_and_started_at_once_is_restarted_without_being_lost(address):
    async def scenario():
        schedule = Schedule(startup_s=0, steady_period_s=20)
        async with Node("here", **address.options()) as node, discovering(node) as watch:
            async with status_process(address, schedule):
                assert await watch.event() == "DISCOVERED"
            async with status_process(address, schedule):
                assert await watch.event() == "RESTARTED"

    asyncio.run(scenario())


def test_giving_up_a_query_to_a_process_that_was_killed_does_not_hold_up_the_others(address):
    async def scenario():
        async with Node("here", **address.options()) as node:
            async with status_process(address) as child:
                client = node.create_client(GET_METADATA, metadata_service("go2"))
                await client.wait_for_service(timeout_s=60)
                child.kill()
                await child.wait()
            with pytest.raises(ServiceTimeoutError):  # it is matched until its lease runs out, and says nothing
                await client.call(service_type(GET_METADATA).request(), timeout_s=0.2)
            threads = set(threading.enumerate())
            client.close()
            assert set(threading.enumerate()) - threads, "a thread waits a second for the acknowledgement"

    asyncio.run(scenario())


def test_an_agent_that_never_answers_is_asked_again_and_never_twice_at_a_time(address):
    async def scenario():
        async with Node("here", **address.options()) as node, Node("there", **address.options()) as there:
            fake = Fake(there, mute=True)
            async with discovering(node, query_timeout_s=0.2) as watch:
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

    asyncio.run(scenario())


def test_a_changed_description_is_updated_and_an_answer_that_lags_behind_is_not_taken(address):
    async def scenario():
        async with Node("here", **address.options()) as node, Node("there", **address.options()) as there:
            fake = Fake(there)
            async with discovering(node) as watch:
                fake.say()
                assert await watch.event() == "DISCOVERED"
                fake.publisher.publish(replace(fake.beat, revision=1).to_message(0))
                await watch.count("mismatched", 1)
                fake.say(revision=1)
                assert await watch.event() == "UPDATED"
            assert fake.most_open == 1

    asyncio.run(scenario())


def test_at_most_so_many_agents_are_asked_at_once_and_all_in_the_end(address):
    async def scenario():
        async with Node("here", **address.options()) as node, Node("there", **address.options()) as there:
            fakes = [Fake(there, replace(BEAT, agent=f"agent{n}x"), mute=True) for n in range(6)]
            async with discovering(node, max_queries=2) as watch:
                for fake in fakes:
                    fake.say()
                await watch.count("asked", 6)
                async with asyncio.timeout(60):
                    while sum(fake.open for fake in fakes) < 2:
                        await asyncio.sleep(0.01)
                assert sum(fake.asked for fake in fakes) == 2
                for fake in fakes:
                    fake.may_answer.set()
                await watch.count("event_discovered", 6)

    asyncio.run(scenario())


def test_own_false_and_too_many_heartbeats_are_counted_and_harmless(address):
    async def scenario():
        async with Node("here", **address.options()) as node, Node("there", **address.options()) as there:
            limits = Limits(beats_per_s=5, burst=10)
            async with discovering(node, limits=limits) as watch:
                own = Fake(node, replace(BEAT, agent="station"))
                own.say(incarnation=5)
                await watch.count("dropped_own", 1)
                spoof = Fake(there, replace(BEAT, agent="station"))
                spoof.say(incarnation=4)
                await watch.count("dropped_spoofed", 1)
                spoof.say(agent="no name")
                spoof.say(agent="husky", period_s=-1.0)
                await watch.count("dropped_malformed", 2)
                flood = there.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), replace(LATCHED, depth=100))
                await flood.wait_for_subscriptions(timeout_s=60)
                for _ in range(60):
                    flood.publish(replace(BEAT, agent="flooder").to_message(0))
                await watch.count("dropped_flood", 30)
                good = Fake(there)
                good.say()
                assert await watch.event() == "DISCOVERED"

    asyncio.run(scenario())


def test_bytes_that_are_no_heartbeat_are_counted_and_harmless(address):
    async def scenario():
        async with (
            Node("here", **address.options()) as node,
            Node("there", **address.options()) as there,
            discovering(node) as watch,
        ):
            fake = Fake(there)
            await fake.publisher.wait_for_subscriptions(timeout_s=60)
            broken = bytearray(serialize(replace(BEAT, agent="aaaa").to_message(0)))
            broken[broken.index(b"aaaa") : broken.index(b"aaaa") + 2] = b"\xff\xfe"  # not UTF-8
            fake.publisher.publish_raw(bytes(broken))
            await watch.count("dropped_malformed", 1)
            fake.say()
            assert await watch.event() == "DISCOVERED"

    asyncio.run(scenario())


def test_a_consumer_that_comes_late_hears_of_everybody_and_a_new_discoverer_replaces_the_old(address):
    async def scenario():
        agents = KnownAgents(grace_ns=1)
        async with Node("here", **address.options()) as node, Node("there", **address.options()) as there:
            fakes = [Fake(there, replace(BEAT, agent=name)) for name in ("go2", "husky")]
            async with Node("first", **address.options()) as first, discovering(first) as watch:
                for fake in fakes:
                    fake.say()
                await watch.count("event_discovered", 2)
                events = node.create_subscription(
                    DISCOVERY_EVENT, discovery_topic("station"), qos=DISCOVERY_QOS
                )
                for _ in fakes:
                    message, info = await events.take_with_info(timeout_s=60)
                    agents.feed(message, info.publisher_gid, now_ns=0)
                assert set(agents.agents) == {"go2", "husky"}
            fakes[1].publisher.close()
            async with Node("second", **address.options()) as second, discovering(second):
                message, info = await events.take_with_info(timeout_s=60)
                assert agents.feed(message, info.publisher_gid, now_ns=0) is None
                assert [w.agent for w in agents.expire(1)] == ["husky"]

    asyncio.run(scenario())


def test_as_a_process_it_reports_events_moves_and_what_it_knows(address):
    async def scenario():
        config = DiscoveryConfig(
            address=address, settings=DiscoverySettings(agent="station", timing=TIMING), report_moves=True
        )
        assert config_from_argument(DiscoveryConfig, argument_of(config)) == config
        async with Node("there", **address.options()) as there:
            Fake(there).say()
            async with process("sfglab.fleet.discovery.node", config) as child:
                reports = []
                async with asyncio.timeout(60):
                    while not reports or reports[-1]["is"] != "event":
                        reports.append(json.loads(await child.stdout.readline()))
                    child.stdin.write(b'{"report": true}\n')
                    while reports[-1]["is"] != "status":
                        reports.append(json.loads(await child.stdout.readline()))
                child.stdin.close()
                assert await asyncio.wait_for(child.wait(), 60) == 0
        assert reports[0] == {"is": "ready"}
        first, event, status = reports[1], next(r for r in reports if r["is"] == "event"), reports[-1]
        assert (first["before"], first["given"], first["actions"]) == ("UNKNOWN", "HEARD", ["QUERY"])
        assert (event["agent"], event["event"], event["incarnation"]) == ("go2", "DISCOVERED", 1)
        assert [(a["agent"], a["state"]) for a in status["agents"]] == [("go2", "ACTIVE")]
        assert status["counts"]["asked"] == 1

    asyncio.run(scenario())


@pytest.mark.parametrize("values", [{"find_timeout_s": 61}, {"query_timeout_s": 0}, {"max_queries": 0}])
def test_settings_that_make_no_sense_are_refused(values):
    with pytest.raises(InvalidValueError):
        DiscoverySettings(agent="station", **values)
