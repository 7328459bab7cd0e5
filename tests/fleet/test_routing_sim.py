"""The same router in the simulated world: many agents, late and lossy, and every message where it belongs."""

import asyncio
from contextlib import asynccontextmanager

import pytest
from cameras import behind_router

from sfglab.component import beside
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router

STRING, METADATA = "std_msgs/msg/String", "sfglab_interfaces/srv/GetMetadata"
AGENTS = ("a", "b", "c", "d")
sim = pytest.fixture(lambda: {"limit_s": 1000})


@asynccontextmanager
async def fleet(world):
    """One node of each agent in its own domain, behind the agent's router to the network's domain 0."""
    places = {agent: behind_router(world, agent) for agent in AGENTS}
    async with beside(*(router.run() for _, router in places.values())):
        yield {agent: node for agent, (node, _) in places.items()}


async def test_the_status_is_told_at_every_change_and_every_five_seconds(sim):
    told = []
    near, far = (sim.node("router", domain_id=domain) for domain in (7, 0))
    settings = RouterSettings(agent="a")
    router = Router(near, far, settings, on_status=lambda status: told.append((sim.now_ns, status)))
    async with beside(router.run()):
        await asyncio.sleep(22)
        quiet = len(told)
        sim.node("one", domain_id=7).create_subscription(STRING, "/global/x")
        await asyncio.sleep(2)
    assert [round(time_ns / 1e9) for time_ns, _ in told[:quiet]] == [0, 5, 10, 15, 20]
    ((_, status),) = told[quiet:]
    (path,) = status.paths
    assert (path.topic, path.readers, path.writers) == ("rt/global/x", 1, 0)


async def test_nothing_local_is_seen_on_the_network(sim):
    async with fleet(sim) as nodes:
        watcher = sim.node("watcher", host="w")
        for node in nodes.values():
            for topic in ("/local/x", "/scan", "/global/unwanted", "/global/wanted"):
                node.create_publisher(STRING, topic)
                node.create_subscription(STRING, topic.replace("un", ""))
        watcher.create_subscription(STRING, "/scan")
        await asyncio.sleep(20)
        assert {e.dds_topic for e in watcher.graph.endpoints() if e.user_data} == {
            "rt/global/wanted"
        }
