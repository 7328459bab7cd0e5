"""Fleets in the simulated world: routed ones with sfglab's components, standard ones with bare endpoints.

The nodes of a routed agent are left out, because nothing of them crosses its router. Each agent has a
computer of its own. Each of its processes has a core (routed), or its share of `CORES` (standard). The
costs of processes are calibrated to live fleets. The simulated world tells when agents know each other
and how many endpoints there are; it counts no bytes.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointEvent, RawEndpoint
from sfglab.bus.sim import Costs, World, run_simulated
from sfglab.component import beside
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.node import StatusProvider
from sfglab.lab.experiment import seeded
from sfglab.lab.experiments.discovery.experiment import (
    PUBLISHING,
    QUERYING,
    STANDARD,
    Config,
    Fleet,
    exp,
)
from sfglab.lab.workers.ros_nodes import LISTENER, TALKER, endpoints_of
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from sfglab.bus.node import Node
    from sfglab.fleet.discovery.registry import Order

CORES = 4  #: Cores of an agent's computer: a Raspberry Pi 5 in paper A, section 5.1.
ROUTED_COSTS = Costs(start_s=0.03, message_s=0.3e-3, endpoint_s=2e-3, announcement_s=50e-6)
"""An agent's three components spend about 0.1 s and 30 ms per peer, as in live fleets of 2 to 12 agents on
two cores. The division among messages and endpoints is an estimate."""
STANDARD_COSTS = Costs(announcement_s=70e-6)
"""Per process and endpoint of the domain: 1.0 s for an agent with 20 nodes and one peer, live."""
LIMIT_S = 300.0  #: Time after which an incomplete fleet is given up, simulated s.
MOST_AGENTS = {STANDARD: 4, QUERYING: 25, PUBLISHING: 25}
"""Agents of the largest simulated fleet. All nodes of a standard one are simulated, 20 per agent."""
ENDPOINTS_PER_NODE = len(endpoints_of(TALKER, "/a/b", "/c"))
_LOCAL_DOMAIN = 1


def fleets_of(config: Config) -> list[Fleet]:
    """Return the fleets to simulate, the largest last."""
    scale = config.simulated
    fleets = []
    for agents in sorted(scale.agents):
        for mode, most in MOST_AGENTS.items():
            if agents <= most:
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
    ours = (fleet.talkers + fleet.listeners) * ENDPOINTS_PER_NODE
    if fleet.mode == STANDARD:
        share = max(1.0, (fleet.talkers + fleet.listeners) / CORES)
        costs = Costs(announcement_s=STANDARD_COSTS.announcement_s * share)
        return run_simulated(partial(run_standard, fleet), seed=seed, costs=costs)
    start_s = ROUTED_COSTS.start_s + ours * ROUTED_COSTS.announcement_s
    costs = replace(ROUTED_COSTS, start_s=start_s)
    return run_simulated(partial(run_routed, fleet), seed=seed, costs=costs)


@dataclass(slots=True)
class Arrivals:
    """Times at which agents have discovered all their peers."""

    world: World
    agents: list[str]  #: Names of the agents, which are those of their hosts.
    resolved_s: dict[str, float] = field(default_factory=dict)  #: Time by agent, s.
    is_complete: asyncio.Event = field(default_factory=asyncio.Event)

    def add(self, agent: str) -> None:
        """Note that an agent has discovered all its peers now."""
        self.resolved_s[agent] = self.world.now_ns / NS_PER_S
        if len(self.resolved_s) == len(self.agents):
            self.is_complete.set()

    async def rows(self) -> tuple[dict[str, Any], ...]:
        """Return one row per agent when all are complete, or when the limit is over."""
        try:
            async with asyncio.timeout(LIMIT_S):
                await self.is_complete.wait()
        except TimeoutError:
            pass
        rows = []
        for host, agent in enumerate(self.agents):
            row = {
                "host": host,
                "resolved_s": self.resolved_s.get(agent, LIMIT_S),
                "censored": agent not in self.resolved_s,
                "endpoints": self.world.announced(),
            }
            rows.append(row)
        return tuple(rows)


def _arrivals(world: World, fleet: Fleet) -> Arrivals:
    agents = [f"agent{number:04d}" for number in range(fleet.agents)]
    return Arrivals(world, agents)


async def run_routed(fleet: Fleet, world: World) -> tuple[dict[str, Any], ...]:
    """Run a fleet of agents behind routers."""
    arrivals = _arrivals(world, fleet)
    for agent in arrivals.agents:
        world.host(agent)
    bodies = []
    for agent in arrivals.agents:
        bodies += components(arrivals, agent, publishes=fleet.mode == PUBLISHING)
    async with beside(*(run() for run in bodies)):
        return await arrivals.rows()


def components(
    arrivals: Arrivals, agent: str, *, publishes: bool
) -> list[Callable[[], Coroutine[Any, Any, None]]]:
    """Return what runs on one agent: router, status provider and discoverer."""
    world = arrivals.world
    inside = partial(world.node, host=agent, domain_id=_LOCAL_DOMAIN, reach="host")
    near = inside("router", process="router")
    far = world.node("router", process="router", host=agent)
    status = inside("agent_status_provider")
    discoverer = inside("agent_discoverer")
    found: set[str] = set()

    def discover(order: Order) -> None:
        if order.event == "DISCOVERED":
            found.add(order.agent)
            if len(found) == len(arrivals.agents) - 1:
                arrivals.add(agent)

    provided = StatusSettings(agent=agent, publish_description=publishes)
    discovered = DiscoverySettings(agent=agent, use_published_descriptions=publishes)
    return [
        Router(near, far, RouterSettings(agent=agent)).run,
        StatusProvider(status, provided).run,
        AgentDiscoverer(discoverer, discovered, on_event=discover).run,
    ]


async def run_standard(fleet: Fleet, world: World) -> tuple[dict[str, Any], ...]:
    """Run a fleet whose nodes are all in one domain."""
    arrivals = _arrivals(world, fleet)
    roles = [TALKER] * fleet.talkers + [LISTENER] * fleet.listeners
    remote = len(roles) * ENDPOINTS_PER_NODE * (fleet.agents - 1)
    for agent in arrivals.agents:
        nodes = [ros_node(world, agent, role, number) for number, role in enumerate(roles)]
        watch(nodes[0], agent, remote, arrivals)
    return await arrivals.rows()


def ros_node(world: World, host: str, role: str, number: int) -> Node:
    """Return a node with the endpoints of one of demo_nodes_cpp."""
    node = world.node(f"{role}_{number}", host=host)
    ends = node.open_forwarder(node)  # bare endpoints without samples
    for plan in endpoints_of(role, f"/{host}/{role}_{number}", f"/{host}/chatter_{number}"):
        endpoint = RawEndpoint(
            dds_topic=plan.topic, type=plan.type, qos=plan.qos, user_data=plan.user_data
        )
        if plan.writer:
            ends.open_writer(endpoint)
        else:
            ends.open(endpoint)
    return node


def watch(node: Node, agent: str, remote: int, arrivals: Arrivals) -> None:
    """Complete an agent when one of its nodes knows all endpoints of the others; its nodes are equally fast."""
    known: set[bytes] = set()
    own = arrivals.world.host(agent).id

    def hear(event: EndpointEvent) -> None:
        if isinstance(event, EndpointAdded) and event.endpoint.host != own:
            known.add(event.endpoint.gid)
            if len(known) == remote:
                arrivals.add(agent)

    node.graph.listen(hear)
