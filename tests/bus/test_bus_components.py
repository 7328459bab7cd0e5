"""Components need no change for another backend: an agent is found through its router over toy domains."""

import asyncio
from contextlib import AsyncExitStack

import pytest
from toy_bus import ToyDomain

from sfglab import bus
from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoverySettings
from sfglab.fleet.router.node import Router, RouterSettings
from sfglab.fleet.status.node import StatusProvider, StatusSettings


async def test_a_discoverer_finds_an_agent_and_its_description_through_the_agents_router():
    own, network = ToyDomain(), ToyDomain()
    news = asyncio.Queue()
    async with AsyncExitStack() as stack:
        near, status, far, station = [
            await stack.enter_async_context(domain.node(name))
            for domain, name in ((own, "near"), (own, "status"), (network, "far"), (network, "station"))
        ]
        found = AgentDiscoverer(station, DiscoverySettings(agent="station"), on_event=news.put_nowait)
        components = [
            Router(near, far, RouterSettings(agent="go2")),
            StatusProvider(status, StatusSettings(agent="go2")),
            found,
        ]
        tasks = [asyncio.create_task(component.run()) for component in components]
        async with asyncio.timeout(60):
            heard = await news.get()
        assert (heard.agent, heard.event) == ("go2", "DISCOVERED")
        assert found.status().counts["asked"] == 1
        assert {e.node for e in station.graph.publishers("/global/agent_heartbeat")} == {"/far"}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


@pytest.mark.live
async def test_nodes_of_two_backends_cannot_be_forwarded_between(live):
    async with ToyDomain().node("toy") as toy, live.node("live") as there:
        with pytest.raises(TypeError, match="given a toy and a live node, allowed are two of one kind"):
            toy.open_forwarder(there)
        with pytest.raises(bus.ClosedError):
            ToyDomain().node("unstarted").open_forwarder(toy)
