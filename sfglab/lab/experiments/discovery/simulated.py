"""Fleets in the simulated world: *routed* with the agents' own components, *standard* with bare endpoints.

Of a routed agent only the ROS 2 nodes are left out, of which nothing crosses. Queries take two endpoints for
each ordered pair of agents: above `EXACT_MOST` agents they are counted (`mean_fleet`). What a standard agent
receives grows in proportion to the other agents, so that larger fleets follow from two small ones.

Every agent has a computer of its own, of which each process has a core (routed) or its share of `CORES`
(standard). What processes spend is calibrated to live fleets: `ROUTED_COSTS`, `STANDARD_COSTS`.
"""

from __future__ import annotations

import asyncio
import gc
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from statistics import mean
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointEvent, RawEndpoint
from sfglab.bus.sim import Costs, SimNode, World, run_simulated
from sfglab.bus.sim.settings import PARTICIPANT_NS
from sfglab.bus.sim.wire import RETRACTION_BYTES
from sfglab.component import beside
from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoverySettings
from sfglab.fleet.router.node import Router, RouterSettings, RouterStatus
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.fleet.status.node import StatusProvider, StatusSettings
from sfglab.lab.experiment import seeded
from sfglab.lab.experiments.discovery.experiment import ROUTED, STANDARD, Config, Fleet, exp
from sfglab.lab.workers.rosstack import LISTENER, TALKER, endpoints_of
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterator

    from sfglab.bus.sim.model import Host
    from sfglab.fleet.discovery.registry import Order

CORES = 4  #: Of an agent's computer: a Raspberry Pi 5 in paper A, section 5.1.

ROUTED_COSTS = Costs(start_s=0.03, message_s=0.3e-3, endpoint_s=2e-3, announcement_s=50e-6)
"""Such that an agent's three components spend about 0.1 s and 30 ms for each peer, as in live fleets of 2 to 12
agents on two cores; how it divides among messages and endpoints is an estimate."""

STANDARD_COSTS = Costs(announcement_s=70e-6)
"""Of each process for each endpoint of the domain: 1.0 s for an agent with 20 nodes and one peer, live."""

LIMIT_S = 300.0  #: When a fleet that is not complete is given up, virtual seconds.

#: Agents of the largest fleets that are simulated agent by agent.
EXACT_MOST = {STANDARD: 4, ROUTED: 100}
_FEW, _MORE, _STEP_S, _LEAST_SHARE = 6, 12, 5e-3, 0.02
_LOCAL_DOMAIN = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class HostOutcome:
    """What came of one agent."""

    #: When it had resolved all its peers, seconds since the start; `LIMIT_S` if it had not.
    resolved_s: float
    rx_bytes: float  #: Received at its interface until then.
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
        return mean_fleet(fleet, seed)
    with _rare_collections():
        return run_simulated(
            partial(_routed, fleet), seed=seed, costs=_routed_costs(fleet), lean_services=True
        )


def _routed_costs(fleet: Fleet) -> Costs:
    ours = (fleet.talkers + fleet.listeners) * len(endpoints_of(TALKER, "/a/b", "/c"))
    return replace(ROUTED_COSTS, start_s=ROUTED_COSTS.start_s + ours * ROUTED_COSTS.announcement_s)


def mean_fleet(fleet: Fleet, seed: int = 0) -> FleetOutcome:
    """Count what a routed fleet's queries ask of the mean agent, instead of simulating all n^2 of them.

    All agents find peers at one rate. For each peer a router makes four endpoints and takes four messages; it
    hears of the two that every other router makes in the global domain, and ignores replies to others on paths
    that it has open: those it had time to open, for queries under way or within its linger of their end. A path
    ends at the cost at which it began; heartbeats cost, too. Times follow from `ROUTED_COSTS`, bytes from the
    retractions and the quadratic through two small fleets.
    """
    n, costs = fleet.agents, _routed_costs(fleet)
    four_s = 4 * (costs.endpoint_s + costs.message_s)
    pair_s = 2 * n * costs.announcement_s
    linger = round(RouterSettings(agent="a").linger_s / _STEP_S)
    slots = DiscoverySettings(agent="a").max_queries
    found, closed, beats = [0.0], 0.0, Schedule()
    while found[-1] < n - 1 and len(found) * _STEP_S < LIMIT_S:
        before, closed = closed, found[-linger] if len(found) >= linger else 0.0
        closing_s = (closed - before) / _STEP_S * (pair_s + 4 * costs.endpoint_s)
        elapsed_s = len(found) * _STEP_S
        period_s = beats.startup_period_s if elapsed_s < beats.startup_s else beats.steady_period_s
        beating_s = n * costs.message_s / period_s
        opened = min(n, found[-1] + slots, elapsed_s / four_s)
        each_s = four_s + pair_s + max(0.0, opened - closed) * costs.message_s
        found.append(found[-1] + max(_LEAST_SHARE, 1 - beating_s - closing_s) / each_s * _STEP_S)
    resolved_s = costs.start_s + PARTICIPANT_NS / NS_PER_S + len(found) * _STEP_S
    few, more = (
        _received_each(replace(fleet, agents=agents), seed) / agents for agents in (_FEW, _MORE)
    )
    rx_bytes = (
        n * (few + (n - _FEW) * (more - few) / (_MORE - _FEW)) + 2 * n * closed * RETRACTION_BYTES
    )
    host = HostOutcome(
        resolved_s=resolved_s, rx_bytes=float(round(rx_bytes)), censored=found[-1] < n - 1
    )
    return FleetOutcome(hosts=(host,) * n, announced=2 * n * (n + 1))


@lru_cache(maxsize=8)
def _received_each(fleet: Fleet, seed: int) -> float:
    return mean(host.rx_bytes for host in run_fleet(fleet, seed).hosts)


@lru_cache(maxsize=64)
def _standard_fleet(fleet: Fleet, seed: int) -> FleetOutcome:
    """Simulate a small fleet, or follow the line through two smaller ones, which all larger ones have."""
    if fleet.agents > EXACT_MOST[STANDARD]:
        few, more = (_standard_fleet(replace(fleet, agents=agents), seed) for agents in (2, 3))
        return _extrapolated(few, more, fleet.agents)
    share = (fleet.talkers + fleet.listeners) / CORES
    costs = replace(STANDARD_COSTS, announcement_s=STANDARD_COSTS.announcement_s * max(1.0, share))
    return run_simulated(partial(_standard, fleet), seed=seed, costs=costs)


def _extrapolated(two: FleetOutcome, three: FleetOutcome, agents: int) -> FleetOutcome:
    """Return a fleet of which each agent is the mean one on the line through fleets of two and three."""

    def at(name: str) -> float:
        first, second = (
            mean(getattr(host, name) for host in outcome.hosts) for outcome in (two, three)
        )
        return float(first + (agents - 2) * (second - first))

    found_s, rx_bytes = at("resolved_s"), float(round(at("rx_bytes")))
    host = HostOutcome(
        resolved_s=min(LIMIT_S, found_s), rx_bytes=rx_bytes, censored=found_s > LIMIT_S
    )
    return FleetOutcome(hosts=(host,) * agents, announced=two.announced // len(two.hosts) * agents)


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Let Python look for cycles seldom: a fleet's millions of objects are all in use."""
    thresholds = gc.get_threshold()
    gc.set_threshold(200_000, 50, 1000)
    try:
        yield
    finally:
        gc.set_threshold(*thresholds)


def _name(host: int) -> str:
    return f"agent{host:04d}"


class _Arrivals:
    """Notes when each host has heard of everything that it waits for."""

    def __init__(self, world: World, hosts: int) -> None:
        self._outcomes: dict[str, HostOutcome] = {}
        self._world, self._hosts = world, hosts
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
        now_s, received = self._world.now_ns / NS_PER_S, float(self._world.received(host))
        self._outcomes[host] = HostOutcome(resolved_s=now_s, rx_bytes=received, censored=censored)


class _QuietRouter(Router):
    """A router of which nobody wants to know the status: to gather it takes as long as there are paths."""

    @property
    def status(self) -> RouterStatus:
        return RouterStatus()


async def _routed(fleet: Fleet, world: World) -> FleetOutcome:
    names = [_name(host) for host in range(fleet.agents)]
    for name in names:
        world.host(name)
    arrivals = _Arrivals(world, fleet.agents)
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
    return [
        _QuietRouter(near, far, RouterSettings(agent=name)).run,
        StatusProvider(status, StatusSettings(agent=name)).run,
        AgentDiscoverer(discoverer, DiscoverySettings(agent=name), on_event=hear).run,
    ]


async def _standard(fleet: Fleet, world: World) -> FleetOutcome:
    arrivals = _Arrivals(world, fleet.agents)
    roles = [TALKER] * fleet.talkers + [LISTENER] * fleet.listeners
    each = len(roles) * len(endpoints_of(TALKER, "/a/b", "/c"))
    for host in range(fleet.agents):
        name = _name(host)
        nodes = [_ros_node(world, name, role, number) for number, role in enumerate(roles)]
        _watch(nodes[0], world.host(name), each * (fleet.agents - 1), arrivals)
    return FleetOutcome(hosts=await arrivals.wait(), announced=world.announced())


def _ros_node(world: World, host: str, role: str, number: int) -> SimNode:
    """Return a node with the endpoints that one of demo_nodes_cpp has; discovery info is among them."""
    node = world.node(f"{role}_{number}", host=host, discovery_info=False)
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
