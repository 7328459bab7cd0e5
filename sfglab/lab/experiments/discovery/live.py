"""Live fleets: their processes, the start orders, and the measurements.

All agents share this machine's cores. If agents start at a pace, the work of one start ends before the next start.
Times begin with the last start order, and bytes with the first. Fleets run live only on separate hosts.
"""

from __future__ import annotations

import asyncio
import time
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.component import end_tasks
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.lab.experiments.discovery.experiment import (
    LAUNCHED,
    STANDARD,
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
    from collections.abc import Callable, Iterable

    from sfglab.component import Report
    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

GLOBAL_DOMAIN = 0
LOAD_S = 300.0  #: Longest time until all processes are loaded, s.
ROUTER, STATUS, DISCOVERER = (
    "sfglab.fleet.router.node",
    "sfglab.fleet.status.node",
    "sfglab.fleet.discovery.node",
)
"""Components of a routed agent."""
_IDLE = "sfglab.lab.workers.idle"
_NEVER = "never"  #: Kind of report that no process sends.
NODES = ", nodes"  #: End of the names of processes with ROS 2 nodes.


@exp.part("fleets", total=lambda config: len(cells_of(config.stages, config.seed)))
async def start_fleets(bench: Bench[Config]) -> None:
    """Start the fleets one after the other."""
    config = bench.config
    start = partial(LiveFleet, testbed=bench.testbed, multicast=config.multicast)
    await run_fleets(bench, cells_of(config.stages, config.seed), start, config.timeout_s)


async def run_fleets(
    bench: Bench[Any],
    cells: Iterable[Cell],
    start: Callable[[Cell], LiveFleet],
    timeout_s: float,
) -> None:
    """Start fleets one after the other, and write their rows into the tables ``host`` and ``cell``.

    Args:
        bench: Context of the run.
        cells: The fleets.
        start: Function that returns the processes of a fleet.
        timeout_s: Time after which a fleet is given up, s.
    """
    if not bench.testbed.separate:
        return
    for number, cell in enumerate(cells):
        async with start(cell) as fleet:
            hosts, load = await fleet.measure(timeout_s, cell=number)
        bench.write_all("host", hosts)
        cpu_s = (load.cpu_percent or 0.0) / 100 * load.window_s
        row = FleetRow(cell=number, **asdict(cell), window_s=load.window_s, cpu_s=cpu_s)
        # The fleet's row is written last, so that a cell in this table is complete.
        bench.write(row)
        bench.advance(f"{cell.mode} {cell.agents}")


class LiveFleet(ProcessGroup):
    """The processes of a fleet, named by host and module. After entering they are loaded and idle.

    Processes of a launched fleet do not exist before the start order. The test bed has at least as
    many hosts as there are agents.
    """

    def __init__(self, cell: Cell, testbed: Testbed, *, multicast: str) -> None:
        self.hosts = host_names(cell.agents)  #: Hosts that take part.
        self._cell = cell
        self._testbed = testbed
        self._multicast = multicast
        self._is_launched = cell.mode == LAUNCHED
        self._is_routed = cell.mode != STANDARD
        self._agents = {host: self.processes_of(n, host) for n, host in enumerate(self.hosts, 1)}
        idle = [] if self._is_launched else [m for each in self._agents.values() for m in each]
        #: Time at which an agent had discovered its peers, ns since the epoch, and what its interface
        #: had received when it reported so, by host.
        self.resolved: dict[str, tuple[int, int]] = {}
        self._peers: dict[str, set[str]] = {host: set() for host in self.hosts}
        self._is_complete = asyncio.Event()
        super().__init__(idle, wrap_command=testbed.argv, on_report=self._take, start_s=LOAD_S)

    @property
    def start_order(self) -> dict[str, Any]:
        """Order that starts the processes of an agent."""
        return {
            "do": "start",
            "fleet": self.hosts,
            "talkers": self._cell.talkers,
            "listeners": self._cell.listeners,
        }

    async def measure(self, timeout_s: float, *, cell: int = 0) -> tuple[list[HostRow], MeterRow]:
        """Start the fleet, and measure until it is complete, or for `timeout_s` seconds after the last start order.

        Returns:
            One row per agent with the counter of the cell, and the CPU of all processes.

        Raises:
            ProcessFailedError: A process failed.
        """
        load = Window(cpu={"fleet": lambda: [self[name].pid for name in self]}, interfaces={})
        before = {host: self.received_bytes(host) for host in self.hosts}
        load.sample(time.time_ns())
        ordered_ns = await self.order_starts()
        await self.wait_until_complete(timeout_s)
        given_up_ns = time.time_ns()
        [used] = load.sample(given_up_ns)
        rows = []
        for number, host in enumerate(self.hosts):
            given_up = given_up_ns, self.received_bytes(host)
            end_ns, received = self.resolved.get(host, given_up)
            row = HostRow(
                cell=cell,
                host=number,
                resolved_s=(end_ns - ordered_ns) / NS_PER_S,
                censored=host not in self.resolved,
                own_bytes=float(received - before[host]),
            )
            rows.append(row)
        return rows, used

    def received_bytes(self, host: str) -> int:
        """Return the number of bytes that the interface of a host has received so far."""
        return self._testbed.meter(host).interface_bytes().rx_bytes

    async def order_starts(self) -> int:
        """Send the start orders at the cell's pace; return the time of the last order, ns since the epoch."""
        starts = []
        begin_s = time.monotonic()
        for number, host in enumerate(self.hosts):
            await asyncio.sleep(begin_s + number * self._cell.pace_s - time.monotonic())
            ordered_ns = time.time_ns()
            starts.append(asyncio.create_task(self._begin(host)))
        await asyncio.gather(*starts)
        return ordered_ns

    async def wait_until_complete(self, timeout_s: float) -> None:
        """Return when each agent has discovered its peers, or after a time limit.

        Raises:
            ProcessFailedError: A process failed.
        """
        failure = asyncio.create_task(self.expect(_NEVER, timeout_s=None))
        complete = asyncio.create_task(self._is_complete.wait())
        try:
            await asyncio.wait(
                [failure, complete], timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED
            )
            if failure.done():
                await failure
        finally:
            await end_tasks(failure, complete)

    def _take(self, name: str, report: Report) -> None:
        """Process the reports of nodes that have discovered all others, and of discoverers that announce a peer."""
        host, _, _ = name.partition(", ")
        # Nodes behind a router have no peers to discover.
        knows_all = report["is"] == "resolved" and not self._is_routed
        if report["is"] == "event" and report["event"] == "DISCOVERED":
            self._peers[host].add(report["agent"])
            knows_all = len(self._peers[host]) == len(self.hosts) - 1
        if knows_all:
            self.resolved.setdefault(host, (report["t_ns"], self.received_bytes(host)))
        if len(self.resolved) == len(self.hosts):
            self._is_complete.set()

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

    def processes_of(self, number: int, host: str) -> list[Member]:
        """Return the processes of an agent, its nodes first."""
        cell, name = self._cell, host + NODES
        local = BusAddress(domain_id=GLOBAL_DOMAIN + number, interface="lo")
        nodes = RosNodesConfig(
            namespace=f"/{host}",
            address=local if self._is_routed else self.shared(host),
            talkers=cell.talkers,
            listeners=cell.listeners,
            peers=0 if self._is_routed else cell.agents - 1,
        )
        module = "sfglab.lab.workers.ros_nodes"
        members = [Member(name=name, host=host, module=module, config=nodes)]
        if self._is_routed:
            members += self._components(host, local)
        return members

    def shared(self, host: str) -> Any:
        """Return the address of a host in the domain that all agents share."""
        return BusAddress(
            domain_id=GLOBAL_DOMAIN,
            interface=self._testbed.interface(host),
            multicast=self._multicast,
        )

    @property
    def publishes(self) -> bool:
        """Whether agents publish their descriptions; the paper's agents query each other's service."""
        return not self._is_launched

    def _components(self, host: str, local: BusAddress) -> list[Member]:
        """Return router, status provider and discoverer of an agent, the discoverer last."""
        publishes = self.publishes
        status = StatusSettings(agent=host, publish_description=publishes)
        discovery = DiscoverySettings(agent=host, use_published_descriptions=publishes)
        configs = {
            ROUTER: RouterConfig(agent=host, local=local, remote=self.shared(host)),
            # Accelerators are not searched for.
            STATUS: StatusConfig(address=local, settings=status, detect=False),
            DISCOVERER: DiscoveryConfig(address=local, settings=discovery),
        }
        # A launched process starts at once; others are loaded, and start when they are ordered to.
        ready, through = ("ready", "") if self._is_launched else ("idle", _IDLE)
        members = []
        for module, config in configs.items():
            member = Member(
                name=f"{host}, {module}",
                host=host,
                module=module,
                config=config,
                ready=ready,
                through=through,
            )
            members.append(member)
        return members
