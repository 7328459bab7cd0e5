"""Live fleets: their processes, the signal that starts them, and what is measured.

All agents share this machine's cores. Started at a pace, the work of one start is done before the next.
Time is counted from the last start order, and bytes from the first. Fleets are live on separate hosts
only.
"""

from __future__ import annotations

import asyncio
import math
import time
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.component import beside, end_tasks
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.lab.experiments.discovery.experiment import (
    LAUNCHED,
    ROUTED,
    Cell,
    Config,
    FleetRow,
    HostRow,
    cells_of,
    exp,
    host_names,
)
from sfglab.lab.meters import MeterRow, Window
from sfglab.lab.workers.ros_nodes import RosNodesConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import CountsBytes, Testbed

GLOBAL_DOMAIN = 0
LOAD_S = 300.0  #: Longest time until all processes are loaded, s.
PERIOD_S = 0.02  #: Time between two readings of the interfaces' counters, s.
ROUTER, STATUS, DISCOVERER = (
    "sfglab.fleet.router.node",
    "sfglab.fleet.status.node",
    "sfglab.fleet.discovery.node",
)
"""Components of a routed agent."""
_NEVER = "never"  #: Kind of report that no process sends.
NODES = ", nodes"  #: End of the names of processes with ROS 2 nodes.


@exp.part("fleets", total=lambda config: len(cells_of(config.stages, config.seed)))
async def start_fleets(bench: Bench[Config]) -> None:
    """Start the fleets one after the other."""
    if bench.hosts is None or not bench.hosts.separate:
        return
    for number, cell in enumerate(cells_of(bench.config.stages, bench.config.seed)):
        async with LiveFleet(cell, bench.testbed, multicast=bench.config.multicast) as fleet:
            hosts, meters = await fleet.measure(bench.config.timeout_s, cell=number)
        bench.write_all("host", hosts)
        nodes, components = meters["nodes"], meters["components"]
        row = FleetRow(
            cell=number,
            **asdict(cell),
            window_s=nodes.window_s,
            nodes_cpu_s=cpu_s(nodes),
            components_cpu_s=cpu_s(components),
        )
        # Last, so that a cell that is in the log is complete.
        bench.write(row)
        bench.advance(f"{cell.mode} {cell.agents}")


def cpu_s(meter: MeterRow) -> float:
    """Return the CPU time in the window of a meter, s; NaN without processes."""
    return math.nan if meter.cpu_percent is None else meter.cpu_percent / 100 * meter.window_s


class LiveFleet(ProcessGroup):
    """The processes of a fleet, named by host and module, loaded and idle when it is entered.

    Processes of a launched fleet do not exist before the start order. The test bed has at least as
    many hosts as there are agents.
    """

    def __init__(self, cell: Cell, testbed: Testbed, *, multicast: str) -> None:
        self.hosts = host_names(cell.agents)  #: Hosts that take part.
        self._cell = cell
        self._testbed = testbed
        self._multicast = multicast
        self._is_launched = cell.mode == LAUNCHED
        self._agents = {host: self.processes_of(n, host) for n, host in enumerate(self.hosts, 1)}
        idle = [] if self._is_launched else [m for each in self._agents.values() for m in each]
        super().__init__(idle, wrap_command=testbed.argv, start_s=LOAD_S)

    @property
    def start_order(self) -> dict[str, Any]:
        """The order that starts its processes."""
        return {
            "do": "start",
            "fleet": self.hosts,
            "talkers": self._cell.talkers,
            "listeners": self._cell.listeners,
        }

    def pids(self, *, nodes: bool) -> list[int]:
        """Return the process ids of the ROS 2 nodes, or of routers, status providers and discoverers."""
        return [self[name].pid for name in self if name.endswith(NODES) is nodes]

    async def measure(
        self, timeout_s: float, *, cell: int = 0
    ) -> tuple[list[HostRow], dict[str, MeterRow]]:
        """Start the fleet, and measure until it is complete, or given up some seconds after the last order.

        Returns:
            One row per agent with the counter of the cell, and the reading of the meters by label.

        Raises:
            ProcessFailedError: A process failed.
        """
        ingress = Ingress([self._testbed.meter(host) for host in self.hosts])
        pids = {
            "nodes": partial(self.pids, nodes=True),
            "components": partial(self.pids, nodes=False),
        }
        window = Window(cpu=pids, interfaces={})
        ingress.read()
        window.sample(time.time_ns())
        begin_ns = time.time_ns()
        async with beside(ingress.run()):
            ordered_ns, resolved_ns = await self.discover(timeout_s)
        self.check()
        ingress.read()
        given_up_ns = time.time_ns()
        meters = {row.label: row for row in window.sample(given_up_ns)}
        rows = []
        for host, at_ns in enumerate(resolved_ns):
            end_ns = given_up_ns if at_ns is None else at_ns
            row = HostRow(
                cell=cell,
                host=host,
                resolved_s=(end_ns - ordered_ns) / NS_PER_S,
                censored=at_ns is None,
                own_bytes=ingress.between(host, begin_ns, end_ns),
            )
            rows.append(row)
        return rows, meters

    async def discover(self, timeout_s: float) -> tuple[int, list[int | None]]:
        """Order all starts, and wait until each agent has discovered its peers.

        Args:
            timeout_s: Longest wait after the last order, s.

        Returns:
            Time of the last order, and the time at which each agent was complete, ns since the epoch;
            None for an agent that was not complete in time.

        Raises:
            ProcessFailedError: A process failed.
        """
        orders_ns, starts = [], []
        begin_s = time.monotonic()
        for number, host in enumerate(self.hosts):
            await asyncio.sleep(begin_s + number * self._cell.pace_s - time.monotonic())
            orders_ns.append(time.time_ns())
            starts.append(asyncio.create_task(self._begin(host)))
        await asyncio.gather(*starts)
        wait = asyncio.create_task(self._resolved(timeout_s))
        watch = asyncio.create_task(self._watch())
        try:
            await asyncio.wait([wait, watch], return_when=asyncio.FIRST_COMPLETED)
            if watch.done():
                await watch
            return max(orders_ns), await wait
        finally:
            await end_tasks(wait, watch)

    async def _resolved(self, timeout_s: float) -> list[int | None]:
        """Return the time at which each agent had discovered its peers."""
        waits = [self._within(timeout_s, host) for host in self.hosts]
        return list(await asyncio.gather(*waits))

    async def _watch(self) -> None:
        """Raise `ProcessFailedError` when a process fails that `_within` does not follow."""
        awaited = {members[-1].name for members in self._agents.values()}
        names = [name for name in self if name not in awaited]
        await self.expect(_NEVER, names, timeout_s=None)

    async def _begin(self, host: str) -> None:
        """Order an agent's start; its processes are launched if they do not exist."""
        members = self._agents[host]
        if not self._is_launched:
            self.order([member.name for member in members], **self.start_order)
            return
        nodes, *components = members

        async def begin_nodes() -> None:
            await self.start(nodes)
            self.order([nodes.name], **self.start_order)

        await asyncio.gather(begin_nodes(), *map(self.start, components))

    async def _within(self, timeout_s: float, host: str) -> int | None:
        """Return the time at which an agent had discovered its peers; None: not in time."""
        nodes, *components = self._agents[host]
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                if components:
                    return await self._announced(components[-1].name)
                report = await self[nodes.name].expect("resolved", timeout_s=None)
                return int(report["t_ns"])
        return None

    async def _announced(self, discoverer: str) -> int:
        """Return the time at which a discoverer had announced each peer."""
        found: set[str] = set()
        while True:
            event = await self[discoverer].expect("event", timeout_s=None)
            if event["event"] == "DISCOVERED":
                found.add(event["agent"])
            if len(found) == len(self.hosts) - 1:
                return int(event["t_ns"])

    def processes_of(self, number: int, host: str) -> list[Member]:
        """Return the processes of an agent, its nodes first."""
        cell, name = self._cell, host + NODES
        is_routed = cell.mode in (ROUTED, LAUNCHED)
        remote = BusAddress(
            domain_id=GLOBAL_DOMAIN,
            interface=self._testbed.interface(host),
            multicast=self._multicast,
        )
        local = BusAddress(domain_id=GLOBAL_DOMAIN + number, interface="lo")
        nodes = RosNodesConfig(
            namespace=f"/{host}",
            address=local if is_routed else remote,
            talkers=cell.talkers,
            listeners=cell.listeners,
            peers=0 if is_routed else cell.agents - 1,
        )
        module = "sfglab.lab.workers.ros_nodes"
        members = [Member(name=name, host=host, module=module, config=nodes)]
        if is_routed:
            members += self._components(host, local, remote)
        return members

    def _components(self, host: str, local: BusAddress, remote: BusAddress) -> list[Member]:
        """Return router, status provider and discoverer of an agent, the discoverer last."""
        publishes = not self._is_launched  # the paper's agents query each other's service
        status = StatusSettings(agent=host, publish_description=publishes)
        discovery = DiscoverySettings(agent=host, use_published_descriptions=publishes)
        configs = {
            ROUTER: RouterConfig(agent=host, local=local, remote=remote),
            # Accelerators are not searched for: the result does not cross the router.
            STATUS: StatusConfig(address=local, settings=status, detect=False),
            DISCOVERER: DiscoveryConfig(address=local, settings=discovery),
        }
        members = []
        for module, config in configs.items():
            member = Member(name=f"{host}, {module}", host=host, module=module, config=config)
            if not self._is_launched:
                member = replace(member, ready="idle", through="sfglab.lab.workers.idle")
            members.append(member)
        return members


class Ingress:
    """Bytes that interfaces have received, over time.

    Each reading has a time stamp of its own. Where a busy machine delays readings, only the
    resolution suffers.
    """

    def __init__(self, meters: Sequence[CountsBytes]) -> None:
        self._meters = meters
        self._readings: list[list[tuple[int, int]]] = [[] for _ in meters]

    def read(self) -> None:
        """Read all counters once."""
        for meter, readings in zip(self._meters, self._readings, strict=True):
            received = meter.interface_bytes().rx_bytes
            readings.append((time.time_ns(), received))

    async def run(self) -> None:
        """Read until cancelled."""
        while True:
            self.read()
            await asyncio.sleep(PERIOD_S)

    def between(self, place: int, start_ns: int, end_ns: int) -> float:
        """Return the bytes that an interface received between two times, ns since the epoch.

        Between readings they are interpolated. `place` is that of the interface among the meters.
        """
        times_ns, received = np.array(self._readings[place], dtype=np.int64).T
        ends_s = (0.0, (end_ns - start_ns) / NS_PER_S)
        first, last = np.interp(ends_s, (times_ns - start_ns) / NS_PER_S, received - received[0])
        return float(last - first)
