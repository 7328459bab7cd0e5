"""Fleets in the simulated world, with sfglab's router, status provider and discoverer on each agent.

The simulation leaves out the nodes of an agent, because their discovery does not pass the router. Each agent has its
own computer, and each of its processes has a core. The costs of processes are calibrated to live fleets.
The simulation gives the times at which agents discover each other, and the number of endpoints; it counts no bytes.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.sim import Costs, World, run_simulated
from sfglab.component import beside
from sfglab.errors import SfglabError
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.node import StatusProvider
from sfglab.lab.experiment import seeded
from sfglab.lab.experiments.discovery.experiment import PUBLISHING, QUERYING, Config, Fleet, exp
from sfglab.lab.workers.ros_nodes import TALKER, endpoints_of
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from sfglab.fleet.discovery.registry import Order

COSTS = Costs(start_s=0.03, message_s=0.3e-3, endpoint_s=2e-3, announcement_s=50e-6)
"""An agent's three components spend about 0.1 s and 30 ms per peer, as in live fleets of 2 to 12 agents on
two cores. The division among messages and endpoints is an estimate."""
LIMIT_S = 300.0  #: Time within which a fleet must be complete, simulated s.
ENDPOINTS_PER_NODE = len(endpoints_of(TALKER, "/a/b", "/c"))
_LOCAL_DOMAIN = 1


def fleets_of(config: Config) -> list[Fleet]:
    """Return the fleets to simulate, the largest last."""
    scale = config.simulated
    fleets = []
    for agents in sorted(scale.agents):
        for mode in (QUERYING, PUBLISHING):
            fleet = Fleet(
                mode=mode, agents=agents, talkers=scale.talkers, listeners=scale.listeners
            )
            fleets.append(fleet)
    return fleets


@exp.sweep(
    "simulated", over=fleets_of, seeds=lambda config: seeded(config, config.simulated.repeats)
)
def simulate_fleet(fleet: Fleet, seed: int) -> tuple[dict[str, Any], ...]:
    """Run one fleet until each agent has discovered its peers; return one row per agent."""
    own = (fleet.talkers + fleet.listeners) * ENDPOINTS_PER_NODE
    costs = replace(COSTS, start_s=COSTS.start_s + own * COSTS.announcement_s)
    return run_simulated(partial(run_fleet, fleet), seed=seed, costs=costs)


async def run_fleet(fleet: Fleet, world: World) -> tuple[dict[str, Any], ...]:
    """Run a fleet of agents behind routers in a simulated world, and return one row per agent.

    Raises:
        SfglabError: The fleet was not complete in time.
    """
    agents = [f"agent{number:04d}" for number in range(fleet.agents)]
    peers: dict[str, set[str]] = {agent: set() for agent in agents}
    resolved_s: dict[str, float] = {}
    is_complete = asyncio.Event()

    def discover(agent: str, order: Order) -> None:
        if order.event != "DISCOVERED":
            return
        peers[agent].add(order.agent)
        if len(peers[agent]) == fleet.agents - 1:
            resolved_s[agent] = world.now_ns / NS_PER_S
        if len(resolved_s) == fleet.agents:
            is_complete.set()

    for agent in agents:
        world.host(agent)
    bodies = []
    for agent in agents:
        bodies += components(
            world, agent, partial(discover, agent), publishes=fleet.mode == PUBLISHING
        )
    async with beside(*(run() for run in bodies)):
        try:
            async with asyncio.timeout(LIMIT_S):
                await is_complete.wait()
        except TimeoutError:
            raise SfglabError(
                f"{len(resolved_s)} of {fleet.agents} simulated agents had discovered all others "
                f"within {LIMIT_S:g} s; simulate smaller fleets"
            ) from None
        endpoints = world.announced()
    rows = []
    for host, agent in enumerate(agents):
        rows.append({"host": host, "resolved_s": resolved_s[agent], "endpoints": endpoints})
    return tuple(rows)


def components(
    world: World, agent: str, on_event: Callable[[Order], None], *, publishes: bool
) -> list[Callable[[], Coroutine[Any, Any, None]]]:
    """Return the coroutine functions of one agent: router, status provider and discoverer."""
    inside = partial(world.node, host=agent, domain_id=_LOCAL_DOMAIN, reach="host")
    near = inside("router", process="router")
    far = world.node("router", process="router", host=agent)
    status = inside("agent_status_provider")
    discoverer = inside("agent_discoverer")
    provided = StatusSettings(agent=agent, publish_description=publishes)
    discovered = DiscoverySettings(agent=agent, use_published_descriptions=publishes)
    return [
        Router(near, far, RouterSettings(agent=agent)).run,
        StatusProvider(status, provided).run,
        AgentDiscoverer(discoverer, discovered, on_event=on_event).run,
    ]
