"""Live fleets: their processes on their hosts, idle, the one signal that starts them, and what is measured.

*Standard*: every agent's ROS 2 nodes are in the global domain. *Routed*: they are in the agent's own domain,
with its status provider and discoverer; its router joins the two. *Launched* is the paper's way: no process is
there before the order, and every agent is asked what it is. Fleets are live only on separate hosts.

All agents share this machine's cores. Started at a pace, the work of one start is done before the next; time is
then counted from the last start order, and bytes from the first.
"""

from __future__ import annotations

import asyncio
import math
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.lab.baselines import PART, REAL, STAND_IN, peer_on
from sfglab.lab.experiments.discovery.experiment import (
    COMPOSED,
    LAUNCHED,
    ROUTED,
    STANDARD,
    Cell,
    Config,
    cells_of,
    exp,
    host_names,
)
from sfglab.lab.meters import MeterRow, Window
from sfglab.lab.ros2 import RosMissingError
from sfglab.lab.workers.ros_nodes import RosNodesConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import CountsBytes, Testbed

GLOBAL_DOMAIN = 0
_LOAD_S = 300.0
_DISCOVERED = "DISCOVERED"  # sfglab_interfaces/msg/AgentDiscoveryEvent
_NODES = ", nodes"  # at the end of their processes' names
_COMPONENTS = (
    "sfglab.fleet.router.node",
    "sfglab.fleet.status.node",
    "sfglab.fleet.discovery.node",
)
"""What an agent runs beside its nodes, routed; the discoverer last."""


# --- The part of the experiment -------------------------------------------------------------------------------


@exp.part("fleets", total=lambda config: len(cells_of(config)))
async def start_fleets(bench: Bench[Config]) -> None:
    """Start the fleets one after the other, standard beside routed."""
    for number, cell in enumerate(
        cells_of(bench.config) if bench.hosts and bench.hosts.separate else ()
    ):
        async with LiveFleet(cell, bench.config, bench.testbed) as fleet:
            outcome = await _start(fleet, bench)
        for host in range(cell.agents):
            bench.write("host", _host_row(number, host, outcome), at_ns=outcome.ends_ns[host])
        # Last, so that a cell that is in the log is complete.
        bench.write("cell", _cell_row(number, cell, outcome), at_ns=max(outcome.ends_ns))
        bench.advance(f"{cell.mode} {cell.agents}")


@exp.part(PART, total=lambda config: len(cells_of(config, config.ros2)), skips=(RosMissingError,))
async def start_beside_ros2(bench: Bench[Config]) -> None:
    """Start fleets of real ROS 2 beside ours of the same nodes."""
    cells = cells_of(bench.config, bench.config.ros2)
    fleets = [
        LiveFleet(cell, bench.config, bench.testbed) for cell in cells
    ]  # refused before one is started
    for cell, each in zip(cells, fleets, strict=True):
        async with each as fleet:
            outcome = await _start(fleet, bench)
        rows = [_host_row(0, host, outcome) for host in range(cell.agents)]
        quantities = {
            "until an agent knows its peers (s)": [row["resolved_s"] for row in rows],
            "received until then (MB)": [row["own_bytes"] / 1e6 for row in rows],
            "cores busy": [
                sum(_cpu_s(meter) / meter.window_s for meter in outcome.meters.values())
            ],
            "longest pause of an observer (s)": [outcome.ingress.longest_pause_s],
        }
        kind = STAND_IN if cell.mode == STANDARD else cell.mode
        key = {"setting": f"{cell.agents} x {cell.talkers + cell.listeners}", "kind": kind}
        for quantity, values in quantities.items():
            of = {**key, "quantity": quantity, "repeat": cell.repeat}
            bench.write_all(PART, [of | {"value": value} for value in values])
        bench.advance(f"{cell.mode} {cell.agents}")


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What came of one start; times are Unix time in nanoseconds."""

    begin_ns: int
    ordered_ns: int  #: When the last start was ordered.
    resolved_ns: list[int | None]
    given_up_ns: int
    ingress: Ingress
    meters: dict[str, MeterRow]

    @property
    def ends_ns(self) -> list[int]:
        """When each agent was complete or given up."""
        return [self.given_up_ns if at_ns is None else at_ns for at_ns in self.resolved_ns]

    def seconds(self, at_ns: int) -> float:
        """Return an instant as seconds since the last start order."""
        return (at_ns - self.ordered_ns) / NS_PER_S


async def _start(fleet: LiveFleet, bench: Bench[Config]) -> _Outcome:
    ingress = Ingress([bench.testbed.meter(host) for host in fleet.hosts])
    window = Window(
        cpu={"nodes": fleet.node_pids, "components": fleet.component_pids}, interfaces={}
    )
    ingress.read()
    window.sample(time.time_ns())
    begin_ns = time.time_ns()
    reading = asyncio.create_task(ingress.run())
    try:
        ordered_ns, resolved_ns = await fleet.find_itself(bench.config.timeout_s)
    finally:
        reading.cancel()
        with suppress(asyncio.CancelledError):
            await reading
    ingress.read()
    end_ns = time.time_ns()
    meters = {row.label: row for row in window.sample(end_ns)}
    return _Outcome(begin_ns, ordered_ns, resolved_ns, end_ns, ingress, meters)


def _host_row(number: int, host: int, outcome: _Outcome) -> dict[str, Any]:
    end_ns = outcome.ends_ns[host]
    own_bytes, own_packets = outcome.ingress.between(host, outcome.begin_ns, end_ns)
    return {
        "cell": number,
        "host": host,
        "resolved_s": outcome.seconds(end_ns),
        "censored": outcome.resolved_ns[host] is None,
        "own_bytes": own_bytes,
        "own_packets": own_packets,
    }


def _cell_row(number: int, cell: Cell, outcome: _Outcome) -> dict[str, Any]:
    meter = outcome.meters["nodes"]
    return {
        "cell": number,
        **asdict(cell),
        "resolved_s": outcome.seconds(max(outcome.ends_ns)),
        "censored": None in outcome.resolved_ns,
        "signal_s": -outcome.seconds(outcome.begin_ns),
        "window_s": meter.window_s,
        "nodes_cpu_s": _cpu_s(meter),
        "components_cpu_s": _cpu_s(outcome.meters["components"]),
        "machine_percent": meter.machine_cpu_percent,
        "steal_percent": meter.steal_percent,
    }


def _cpu_s(meter: MeterRow) -> float:
    return math.nan if meter.cpu_percent is None else meter.cpu_percent / 100 * meter.window_s


# --- A fleet --------------------------------------------------------------------------------------------------


class LiveFleet(ProcessGroup):
    """A fleet whose processes, named by host and what they are, are loaded and idle once it is entered.

    The test bed has at least as many hosts as there are agents.
    """

    def __init__(self, cell: Cell, config: Config, testbed: Testbed) -> None:
        self.hosts = host_names(cell.agents)  #: The hosts that take part.
        self._cell, self._config, self._testbed = cell, config, testbed
        nodes = {
            "talkers": cell.talkers,
            "listeners": cell.listeners,
            "composed": cell.mode == COMPOSED,
        }
        #: What its processes are told, to find the others.
        self.start_order: dict[str, Any] = {"do": "start", "fleet": self.hosts, **nodes}
        present = [] if cell.mode == LAUNCHED else list(enumerate(self.hosts, start=1))
        members = [member for number, host in present for member in self._members_on(number, host)]
        super().__init__(members, wrap_command=testbed.argv, start_s=_LOAD_S)

    def node_pids(self) -> list[int]:
        """Return the process ids of the ROS 2 nodes that are there."""
        return [self[name].pid for name in self if name.endswith(_NODES)]

    def component_pids(self) -> list[int]:
        """Return those of routers, status providers and discoverers."""
        return [self[name].pid for name in self if not name.endswith(_NODES)]

    async def find_itself(self, timeout_s: float) -> tuple[int, list[int | None]]:
        """Order all starts; return when the last one was, and when each agent had resolved all its peers.

        Times are Unix time, ns; None is an agent that had not in time, counted from the last order.

        Raises:
            ProcessFailedError: A process failed.
        """
        pace_s, starts, orders = self._cell.pace_s, [], []
        begin_s = time.monotonic()
        for number, host in enumerate(self.hosts):
            await asyncio.sleep(begin_s + number * pace_s - time.monotonic())
            orders.append(time.time_ns())
            starts.append(asyncio.create_task(self._begin(number, host)))
        await asyncio.gather(*starts)
        return max(orders), list(
            await asyncio.gather(*(self._within(timeout_s, host) for host in self.hosts))
        )

    async def _begin(self, number: int, host: str) -> None:
        """Order an agent's start; what is not there is launched."""
        if self._cell.mode != LAUNCHED:
            self.order([name for name in self if name.startswith(f"{host}, ")], **self.start_order)
            return

        async def begin_nodes() -> None:
            await self.start(nodes)
            self.order([nodes.name], **self.start_order)

        nodes, *components = self._members_on(number + 1, host)
        await asyncio.gather(begin_nodes(), *map(self.start, components))

    async def _within(self, timeout_s: float, host: str) -> int | None:
        """Return when an agent had resolved all its peers; None: not in time."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                if self._cell.mode in (ROUTED, LAUNCHED):
                    return await self._wait_routed(host)
                return int((await self[_nodes_of(host)].expect("resolved", timeout_s=None))["t_ns"])
        return None

    async def _wait_routed(self, host: str) -> int:
        """Return when the discoverer had announced every peer, and complain about components that fail."""
        *others, discoverer = (f"{host}, {module}" for module in _COMPONENTS)
        if self._cell.mode == LAUNCHED:  # it waited until all were ready
            return await self._peers_announced(discoverer)
        ready = self.expect("ready", others, timeout_s=None)
        announced, _ = await asyncio.gather(self._peers_announced(discoverer), ready)
        return announced

    async def _peers_announced(self, discoverer: str) -> int:
        found: set[str] = set()
        while True:
            event = await self[discoverer].expect("event", timeout_s=None)
            if event["event"] == _DISCOVERED:
                found.add(event["agent"])
            if len(found) == len(self.hosts) - 1:
                return int(event["t_ns"])

    def _members_on(self, number: int, host: str) -> Iterator[Member]:
        """Yield what runs on an agent, its nodes first."""
        if self._cell.mode in (REAL, COMPOSED):
            yield peer_on(self._testbed, host, _nodes_of(host), host, "crowd")
            return
        routed = self._cell.mode in (ROUTED, LAUNCHED)
        interface, multicast = self._testbed.interface(host), self._config.multicast
        remote = BusAddress(domain_id=GLOBAL_DOMAIN, interface=interface, multicast=multicast)
        local = BusAddress(domain_id=GLOBAL_DOMAIN + number, interface="lo")
        nodes = RosNodesConfig(
            namespace=f"/{host}",
            address=local if routed else remote,
            talkers=self._cell.talkers,
            listeners=self._cell.listeners,
            peers=0 if routed else len(self.hosts) - 1,
        )
        yield Member(
            name=_nodes_of(host), host=host, module="sfglab.lab.workers.ros_nodes", config=nodes
        )
        if not routed:
            return
        published = self._cell.mode == ROUTED  # the paper's agents query each other's service
        configs = (
            RouterConfig(agent=host, local=local, remote=remote),
            # Trying accelerators belongs to another experiment, and its result does not cross here.
            StatusConfig(
                address=local,
                settings=StatusSettings(agent=host, publish_description=published),
                detect=False,
            ),
            DiscoveryConfig(
                address=local,
                settings=DiscoverySettings(agent=host, use_published_descriptions=published),
            ),
        )
        for module, config in zip(_COMPONENTS, configs, strict=True):
            member = Member(name=f"{host}, {module}", host=host, module=module, config=config)
            idle: dict[str, Any] = {"ready": "idle", "through": "sfglab.lab.workers.idle"}
            yield member if self._cell.mode == LAUNCHED else replace(member, **idle)


def _nodes_of(host: str) -> str:
    return host + _NODES


# --- Received bytes -------------------------------------------------------------------------------------------

_PERIOD_S = 0.02


class Ingress:
    """Bytes that every meter's interface has received, as a curve that can be asked for any instant.

    Readings have stamps of their own: where a busy machine makes them late, only the curve gets coarser.
    """

    def __init__(self, meters: Sequence[CountsBytes]) -> None:
        self._meters = meters
        self._readings: list[list[tuple[int, int, int]]] = [[] for _ in meters]

    def read(self) -> None:
        """Read all counters once."""
        for meter, readings in zip(self._meters, self._readings, strict=True):
            counted = meter.interface_bytes()
            readings.append((time.time_ns(), counted.rx_bytes, counted.rx_packets))

    @property
    def longest_pause_s(self) -> float:
        """The longest time between two readings: beyond their period nobody let the reader run."""
        return float(np.max(np.diff([t_ns for t_ns, _, _ in self._readings[0]]))) / NS_PER_S

    async def run(self) -> None:
        """Read until cancelled."""
        while True:
            self.read()
            await asyncio.sleep(_PERIOD_S)

    def between(self, host: int, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Return the bytes and frames that a host received between two instants (Unix time, nanoseconds).

        Between readings they are interpolated; the host is named by its place among the meters.
        """
        table = np.array(self._readings[host], dtype=np.int64)
        times_s = (table[:, 0] - start_ns) / NS_PER_S
        ends_s = (0.0, (end_ns - start_ns) / NS_PER_S)
        received, packets = (
            np.diff(np.interp(ends_s, times_s, table[:, i] - table[0, i])) for i in (1, 2)
        )
        return float(received[0]), float(packets[0])
