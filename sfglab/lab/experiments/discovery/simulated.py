"""Fleets in the simulated world: *routed* with the agents' own components, *standard* with bare endpoints.

Of a routed agent only the ROS 2 nodes are left out, of which nothing crosses. The simulated world
gives times and no bytes; bytes follow from formulas (`received_bytes`). Queries take two endpoints
for each ordered pair of agents: above `EXACT_MOST` routed agents no time is simulated, and only the
bytes are given. What a standard agent waits for grows in proportion to the other agents, so that
times of larger fleets follow from two small ones.

Every agent has a computer of its own, of which each process has a core (routed) or its share of
`CORES` (standard). What processes spend is calibrated to live fleets: `ROUTED_COSTS`,
`STANDARD_COSTS`.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from statistics import mean
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointEvent, RawEndpoint
from sfglab.bus.sim import Costs, SimNode, World, run_simulated
from sfglab.component import beside
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.node import StatusProvider
from sfglab.lab.experiment import seeded
from sfglab.lab.experiments.discovery.experiment import ROUTED, STANDARD, Config, Fleet, exp
from sfglab.lab.workers.ros_nodes import LISTENER, TALKER, endpoints_of
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from sfglab.bus.sim.network import Host
    from sfglab.fleet.discovery.registry import Order

CORES = 4  #: Of an agent's computer: a Raspberry Pi 5 in paper A, section 5.1.

ROUTED_COSTS = Costs(start_s=0.03, message_s=0.3e-3, endpoint_s=2e-3, announcement_s=50e-6)
"""Such that an agent's three components spend about 0.1 s and 30 ms for each peer, as in live fleets of 2 to 12
agents on two cores; how it divides among messages and endpoints is an estimate."""

STANDARD_COSTS = Costs(announcement_s=70e-6)
"""Of each process for each endpoint of the domain: 1.0 s for an agent with 20 nodes and one peer, live."""

LIMIT_S = 300.0  #: When a fleet that is not complete is given up, virtual seconds.

#: Agents of the largest fleets that are simulated agent by agent.
EXACT_MOST = {STANDARD: 4, ROUTED: 25}
_LOCAL_DOMAIN = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class HostOutcome:
    """What came of one agent."""

    #: When it had resolved all its peers, seconds since the start; `LIMIT_S` if it had not, NaN of
    #: a fleet that is too large to be simulated.
    resolved_s: float
    rx_bytes: float  #: Received at its interface until then, by formula.
    censored: bool  #: Whether it was given up.


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetOutcome:
    """What came of a fleet."""

    hosts: tuple[HostOutcome, ...]  #: One for each agent.
    #: How many endpoints the global domain had had when the last agent was complete.
    announced: int


def fleets_of(config: Config) -> list[Fleet]:
    """Return the fleets to simulate, the largest last."""
    scale = config.simulated
    return [
        Fleet(mode=mode, agents=agents, talkers=scale.talkers, listeners=scale.listeners)
        for agents in sorted(scale.agents)
        for mode in (STANDARD, ROUTED)
    ]


@exp.sweep(
    "simulated", over=fleets_of, seeds=lambda config: seeded(config, config.simulated.repeats)
)
def simulate_fleet(fleet: Fleet, seed: int) -> tuple[dict[str, Any], ...]:
    """Run one fleet until every agent knows its peers, and return one row an agent."""
    return tuple(
        {"host": number, **asdict(host)} for number, host in enumerate(run_fleet(fleet, seed).hosts)
    )


def run_fleet(fleet: Fleet, seed: int = 0) -> FleetOutcome:
    """Run one fleet until every agent knows its peers."""
    if fleet.mode == STANDARD:
        return _standard_fleet(fleet, seed)
    if fleet.agents > EXACT_MOST[ROUTED]:
        host = HostOutcome(resolved_s=math.nan, rx_bytes=received_bytes(fleet), censored=False)
        return FleetOutcome(hosts=(host,) * fleet.agents, announced=0)
    return run_simulated(partial(_routed, fleet), seed=seed, costs=_routed_costs(fleet))


def received_bytes(fleet: Fleet) -> float:
    """Return what an agent's interface receives until it has resolved its peers, by formula.

    The constants come from a former simulation that counted each packet of Cyclone DDS 11.0.1. Of
    routed fleets they follow from 2 and 6 agents and hold within 2.5 % up to 50 agents (19 % too low
    at 100); of standard fleets from agents with 2 and 20 nodes, and hold within 1 % in between.
    """
    n, nodes = fleet.agents, fleet.talkers + fleet.listeners
    if fleet.mode == ROUTED:
        return 6216.0 * (n - 1) + 1342.0 * n * (n - 1)
    return (n - 1) * (4913.0 * nodes + 6367.0 * nodes**2)


def _routed_costs(fleet: Fleet) -> Costs:
    ours = (fleet.talkers + fleet.listeners) * len(endpoints_of(TALKER, "/a/b", "/c"))
    return replace(ROUTED_COSTS, start_s=ROUTED_COSTS.start_s + ours * ROUTED_COSTS.announcement_s)


@lru_cache(maxsize=64)
def _standard_fleet(fleet: Fleet, seed: int) -> FleetOutcome:
    """Simulate a small fleet, or follow the line through two smaller ones, which all larger ones have."""
    if fleet.agents > EXACT_MOST[STANDARD]:
        few, more = (_standard_fleet(replace(fleet, agents=agents), seed) for agents in (2, 3))
        return _extrapolated(few, more, fleet)
    share = (fleet.talkers + fleet.listeners) / CORES
    costs = replace(STANDARD_COSTS, announcement_s=STANDARD_COSTS.announcement_s * max(1.0, share))
    return run_simulated(partial(_standard, fleet), seed=seed, costs=costs)


def _extrapolated(two: FleetOutcome, three: FleetOutcome, fleet: Fleet) -> FleetOutcome:
    """Return a fleet of which each agent is the mean one on the line through fleets of two and three."""
    first_s, second_s = (mean(host.resolved_s for host in one.hosts) for one in (two, three))
    found_s = first_s + (fleet.agents - 2) * (second_s - first_s)
    host = HostOutcome(
        resolved_s=min(LIMIT_S, found_s),
        rx_bytes=received_bytes(fleet),
        censored=found_s > LIMIT_S,
    )
    each = two.announced // len(two.hosts)
    return FleetOutcome(hosts=(host,) * fleet.agents, announced=each * fleet.agents)


def _name(host: int) -> str:
    return f"agent{host:04d}"


class _Arrivals:
    """Notes when each host has heard of everything that it waits for."""

    def __init__(self, world: World, fleet: Fleet) -> None:
        self._outcomes: dict[str, HostOutcome] = {}
        self._world, self._hosts = world, fleet.agents
        self._rx_bytes = received_bytes(fleet)
        self._all = asyncio.Event()

    def complete(self, host: str) -> None:
        self._note(host, censored=False)
        if len(self._outcomes) == self._hosts:
            self._all.set()

    async def wait(self) -> tuple[HostOutcome, ...]:
        """Return all outcomes when all hosts are complete, or when it has taken too long."""
        try:
            async with asyncio.timeout(LIMIT_S):
                await self._all.wait()
        except TimeoutError:
            for host in map(_name, range(self._hosts)):
                if host not in self._outcomes:
                    self._note(host, censored=True)
        return tuple(self._outcomes[_name(host)] for host in range(self._hosts))

    def _note(self, host: str, *, censored: bool) -> None:
        now_s = self._world.now_ns / NS_PER_S
        self._outcomes[host] = HostOutcome(
            resolved_s=now_s, rx_bytes=self._rx_bytes, censored=censored
        )


async def _routed(fleet: Fleet, world: World) -> FleetOutcome:
    names = [_name(host) for host in range(fleet.agents)]
    for name in names:
        world.host(name)
    arrivals = _Arrivals(world, fleet)
    async with beside(*(run() for name in names for run in _components(world, name, arrivals))):
        hosts = await arrivals.wait()
        announced = world.announced()
    return FleetOutcome(hosts=hosts, announced=announced)


def _components(
    world: World, name: str, arrivals: _Arrivals
) -> list[Callable[[], Coroutine[Any, Any, None]]]:
    """Return what runs on one agent: router, status provider and discoverer."""
    inside = partial(world.node, host=name, domain_id=_LOCAL_DOMAIN, reach="host")
    near = inside("router", process="router")
    far = world.node("router", process="router", host=name)
    found: set[str] = set()

    def hear(news: Order) -> None:
        if news.event == "DISCOVERED":
            found.add(news.agent)
            if len(found) == len(world.hosts) - 1:
                arrivals.complete(name)

    status = inside("agent_status_provider")
    discoverer = inside("agent_discoverer")
    # The paper's agents query each other's metadata service.
    provided = StatusSettings(agent=name, publish_description=False)
    discovered = DiscoverySettings(agent=name, use_published_descriptions=False)
    return [
        Router(near, far, RouterSettings(agent=name)).run,
        StatusProvider(status, provided).run,
        AgentDiscoverer(discoverer, discovered, on_event=hear).run,
    ]


async def _standard(fleet: Fleet, world: World) -> FleetOutcome:
    arrivals = _Arrivals(world, fleet)
    roles = [TALKER] * fleet.talkers + [LISTENER] * fleet.listeners
    each = len(roles) * len(endpoints_of(TALKER, "/a/b", "/c"))
    for host in range(fleet.agents):
        name = _name(host)
        nodes = [_ros_node(world, name, role, number) for number, role in enumerate(roles)]
        _watch(nodes[0], world.host(name), each * (fleet.agents - 1), arrivals)
    return FleetOutcome(hosts=await arrivals.wait(), announced=world.announced())


def _ros_node(world: World, host: str, role: str, number: int) -> SimNode:
    """Return a node with the endpoints that one of demo_nodes_cpp has, discovery info among them."""
    node = world.node(f"{role}_{number}", host=host)
    ends = node.open_forwarder(node)  # bare endpoints, whose samples nobody looks at
    for plan in endpoints_of(role, f"/{host}/{role}_{number}", f"/{host}/chatter_{number}"):
        endpoint = RawEndpoint(
            dds_topic=plan.topic, type=plan.type, qos=plan.qos, user_data=plan.user_data
        )
        if plan.writer:
            ends.open_writer(endpoint)
        else:
            ends.open(endpoint)
    return node


def _watch(node: SimNode, host: Host, remote: int, arrivals: _Arrivals) -> None:
    """Complete a host once one of its nodes knows all endpoints of the others; its nodes learn at one pace."""
    known: set[bytes] = set()

    def hear(event: EndpointEvent) -> None:
        if isinstance(event, EndpointAdded) and event.endpoint.host != host.id:
            known.add(event.endpoint.gid)
            if len(known) == remote:
                arrivals.complete(host.name)

    node.graph.listen(hear)
