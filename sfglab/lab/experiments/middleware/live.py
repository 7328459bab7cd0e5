"""Live parts: fleets of processes, fleets of Zenoh sessions, and flows between two agents.

Agents share this machine's cores. The processes of a fleet are loaded before its start order. The hub is on a host
of its own, in all ways. Nothing runs without separate hosts.
"""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.bus.zenoh.address import PORT, ZenohAddress
from sfglab.fleet.hub import hub_config
from sfglab.fleet.router.config import RouterConfig
from sfglab.lab.experiments.discovery.experiment import host_names
from sfglab.lab.experiments.discovery.live import (
    GLOBAL_DOMAIN,
    LOAD_S,
    ROUTER,
    LiveFleet,
    run_fleets,
)
from sfglab.lab.experiments.middleware.experiment import (
    ASKING,
    DATA_WAYS,
    FLOWS,
    HUB,
    PEERS,
    PUBLISHED,
    RATES_HZ,
    Config,
    FlowRow,
    SessionsRow,
    exp,
    fleets_of,
)
from sfglab.lab.meters import CpuMeter, process_table
from sfglab.lab.workers.flows import FlowsConfig
from sfglab.lab.workers.zenoh_agents import ZenohAgentsConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

SESSIONS_PER_PROCESS = 100
STEP_S = 120.0  #: Longest time until a process reports what it was ordered to do, s.
SETTLE_S = 0.3  #: Time in which a hub knows the subscriptions of new sessions, s.
QUIET_S = 0.3  #: Time after a flow in which its last messages arrive, s.
HERE, THERE = host_names(2)
DOMAINS = {PUBLISHED: (51, 52), HUB: (53, 54), PEERS: (55, 56)}
"""Domains of the agents that publish and subscribe, by way of their flow."""


def shared_address(testbed: Testbed, way: str, host: str) -> Any:
    """Return the address of an agent between agents."""
    if way == HUB:
        return ZenohAddress(hubs=(testbed.address(HUB),))
    if way == PEERS:
        # The first peer makes the others known to each other.
        known = () if host == HERE else (testbed.address(HERE),)
        return ZenohAddress(hubs=(), peers=known)
    return BusAddress(domain_id=GLOBAL_DOMAIN, interface=testbed.interface(host))


def hub_process() -> Member:
    """Return the process of the hub."""
    config = hub_config()
    return Member(name=HUB, host=HUB, module="sfglab.fleet.hub", config=config)


class MiddlewareFleet(LiveFleet):
    """The processes of a fleet whose routers are connected in one of the ways."""

    def shared(self, host: str) -> Any:
        """Return the address of a host between agents."""
        return shared_address(self._testbed, self._cell.mode, host)

    @property
    def publishes(self) -> bool:
        """Whether agents publish their descriptions in their domains; otherwise they query each other's service."""
        return self._cell.mode != ASKING


@exp.part("fleets", total=lambda config: len(fleets_of(config)))
async def start_fleets(bench: Bench[Config]) -> None:
    """Start the fleets of processes one after the other."""
    config, testbed = bench.config, bench.testbed
    start = partial(MiddlewareFleet, testbed=testbed, multicast="default")
    async with ProcessGroup([hub_process()], wrap_command=testbed.argv):
        await run_fleets(bench, fleets_of(config), start, config.timeout_s)


# --- Fleets of sessions -------------------------------------------------------------------------


@exp.part("sessions", total=lambda config: len(config.sessions))
async def start_sessions(bench: Bench[Config]) -> None:
    """Start fleets of Zenoh sessions, which are clients of one hub."""
    config, testbed = bench.config, bench.testbed
    for agents in config.sessions if testbed.separate else ():
        members = [hub_process()]
        count = -(-agents // SESSIONS_PER_PROCESS)
        for place in range(count):
            process = ZenohAgentsConfig(
                hub=f"tcp/{testbed.address(HUB)}:{PORT}",
                numbers=tuple(range(place, agents, count)),
                fleet=agents,
            )
            module = "sfglab.lab.workers.zenoh_agents"
            members.append(Member(name=f"{place}", host=HERE, module=module, config=process))
        async with ProcessGroup(members, wrap_command=testbed.argv) as group:
            bench.write(await measure_sessions(bench, agents, group))
        bench.advance(f"{agents} sessions")


async def measure_sessions(bench: Bench[Config], agents: int, group: ProcessGroup) -> SessionsRow:
    """Let sessions start and discover each other, let one get all descriptions, and observe them idle."""
    config, meter = bench.config, bench.testbed.meter(HERE)
    processes = [name for name in group if name != HUB]
    cpu = CpuMeter([group[HUB].pid])
    cpu.sample(process_table())
    received = [meter.interface_bytes().rx_bytes]
    begin_ns = time.time_ns()
    await group.ask("opened", processes, timeout_s=STEP_S, do="open")
    missing = agents
    while missing:
        start_ns = time.time_ns() + round(SETTLE_S * NS_PER_S)
        order = {"begin_ns": start_ns, "period_s": agents / config.heartbeats_hz}
        beaten = await group.ask("beaten", processes, timeout_s=STEP_S, do="beat", **order)
        missing = sum(report["missing"] for report in beaten.values())
    known_ns = max(report["t_ns"] for report in beaten.values())
    hub_cpu_s = cpu.sample(process_table()) / NS_PER_S
    received.append(meter.interface_bytes().rx_bytes)
    fetched = await group.ask("fetched", processes[:1], timeout_s=STEP_S, do="fetch")
    received.append(meter.interface_bytes().rx_bytes)
    await asyncio.sleep(config.idle_s)
    received.append(meter.interface_bytes().rx_bytes)
    presence, descriptions, idle = np.diff(received)
    return SessionsRow(
        agents=agents,
        known_s=(known_ns - begin_ns) / NS_PER_S,
        presence_bytes=presence / agents,
        hub_cpu_s=hub_cpu_s,
        descriptions=fetched[processes[0]]["replies"],
        described_bytes=presence / agents + descriptions,
        idle_bps=idle / config.idle_s / agents,
    )


# --- Flows between two agents -------------------------------------------------------------------


def flow_processes(testbed: Testbed) -> list[Member]:
    """Return hub, routers of all ways, and a publisher and a subscriber with a node for each way."""
    members = [hub_process()]
    for place, (host, role) in enumerate({HERE: "publisher", THERE: "subscriber"}.items()):
        addresses = {way: shared_address(testbed, way, host) for way in DATA_WAYS}
        for way, domains in DOMAINS.items():
            local = BusAddress(domain_id=domains[place], interface="lo")
            config = RouterConfig(agent=host, local=local, remote=addresses[way])
            members.append(Member(name=f"{way} {role}", host=host, module=ROUTER, config=config))
            addresses[way] = local
        flows = FlowsConfig(places=addresses, publishes=host == HERE)
        members.append(
            Member(name=role, host=host, module="sfglab.lab.workers.flows", config=flows)
        )
    return members


async def send(group: ProcessGroup, way: str, kind: str, seconds: float) -> list[int]:
    """Publish on a flow for a time, and return the latencies of the received messages, ns."""
    flow = f"{way} {kind}"
    order = {"flow": flow, "rate_hz": RATES_HZ[kind], "seconds": seconds}
    begin_ns = time.time_ns()
    await group.ask("sent", ["publisher"], timeout_s=STEP_S, do="send", **order)
    await asyncio.sleep(QUIET_S)
    told = await group.ask("told", ["subscriber"], timeout_s=STEP_S, do="tell")
    times_ns = told["subscriber"][flow]
    return [received_ns - sent_ns for sent_ns, received_ns in times_ns if sent_ns >= begin_ns]


@exp.part("flows", total=lambda config: config.flow_repeats)
async def measure_flows(bench: Bench[Config]) -> None:
    """Measure all flows in each repetition, one after the other in random order."""
    config, testbed = bench.config, bench.testbed
    if not testbed.separate:
        return
    members = flow_processes(testbed)
    async with ProcessGroup(members, wrap_command=testbed.argv, start_s=LOAD_S) as group:
        async with asyncio.timeout(STEP_S):
            for kind, way in FLOWS:
                while not await send(group, way, kind, QUIET_S):
                    pass  # discovery is not complete yet
        rng = np.random.default_rng(config.seed)
        longest_ns = [round(config.flow_s * NS_PER_S)]
        for repeat in range(config.flow_repeats):
            for kind, way in rng.permutation(FLOWS).tolist():
                names = [name for name in group if name.startswith(way)]
                cpu = CpuMeter([group[name].pid for name in ("publisher", "subscriber", *names)])
                cpu.sample(process_table())
                latencies_ns = await send(group, way, kind, config.flow_s)
                sent = round(config.flow_s * RATES_HZ[kind])
                row = FlowRow(
                    repeat=repeat,
                    way=way,
                    kind=kind,
                    sent=sent,
                    received=len(latencies_ns),
                    latency_ms=float(np.median(latencies_ns or longest_ns)) / NS_PER_MS,
                    cpu_ms=cpu.sample(process_table()) / NS_PER_MS / sent,
                )
                bench.write(row)
            bench.advance(f"repetition {repeat}")
