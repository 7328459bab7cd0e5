"""One fleet of a cell: its processes on their hosts, idle, and the one signal that starts them.

*Standard*: every agent's ROS 2 nodes are in the global domain. *Routed*: they are in the agent's own domain,
with its status provider and discoverer; its router joins the two. Knows how to start, order and end them;
refuses to know what is measured.
"""

from __future__ import annotations

import asyncio
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.fleet.discovery.node import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.router.node import RouterConfig
from sfglab.fleet.status.node import StatusConfig, StatusSettings
from sfglab.lab.experiments.discovery.config import ROUTED
from sfglab.lab.staging import Staged
from sfglab.lab.workers.rosnodes import RosNodesConfig
from sfglab.processes import LineProcess

if TYPE_CHECKING:
    from collections.abc import Awaitable

    from sfglab.lab.experiments.discovery.config import Config
    from sfglab.lab.testbed import Testbed


GLOBAL_DOMAIN = 0
_LOAD_S = 60.0
# Whoever waits decides how long; this only bounds a wait that was forgotten.
_FOREVER_S = 86400.0
_DISCOVERED = "DISCOVERED"  # sfglab_interfaces/msg/AgentDiscoveryEvent


def host_names(count: int) -> list[str]:
    """Return the names of the hosts, which are their agents' too."""
    return [f"agent_{number}" for number in range(1, count + 1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A fleet to be started once."""

    mode: str  #: ``standard`` or ``routed``.
    agents: int  #: How many.
    talkers: int  #: Publishing nodes of each.
    listeners: int  #: Subscribing nodes of each.
    repeat: int  #: Which repetition.


class Fleet(Staged):
    """A fleet whose processes are loaded and idle; an async context manager that ends them.

    Args:
        cell: Which fleet.
        config: The experiment.
        testbed: Hosts, at least as many as agents.

    Attributes:
        hosts: The hosts that take part.
    """

    def __init__(self, cell: Cell, config: Config, testbed: Testbed) -> None:
        super().__init__()
        self.hosts = host_names(cell.agents)
        self._cell = cell
        self._config = config
        self._testbed = testbed
        self._started: list[LineProcess] = []
        self._nodes: list[LineProcess] = []
        self._components: list[list[LineProcess]] = []

    @property
    def node_pids(self) -> tuple[int, ...]:
        """Process ids of the ROS 2 nodes."""
        return tuple(process.pid for process in self._nodes)

    @property
    def component_pids(self) -> tuple[int, ...]:
        """Process ids of routers, status providers and discoverers."""
        return tuple(process.pid for processes in self._components for process in processes)

    def signal(self) -> tuple[int, int]:
        """Start everything; return when the signal began and when all had been given it (Unix time, ns)."""
        begin_ns = time.time_ns()
        for nodes, components in zip(self._nodes, self._components, strict=True):
            nodes.order(do="start")
            for component in components:
                component.order(do="start")
        return begin_ns, time.time_ns()

    async def resolved(self, timeout_s: float) -> list[int | None]:
        """Return when each agent had resolved all its peers (Unix time, ns), None where it did not in time.

        Raises:
            ProcessFailedError: A process failed.
        """
        wait = self._wait_routed if self._cell.mode == ROUTED else self._wait_standard
        return list(await asyncio.gather(*(_within(timeout_s, wait(i)) for i in range(len(self.hosts)))))

    async def _wait_standard(self, host: int) -> int:
        report = await self._nodes[host].expect("resolved", timeout_s=_FOREVER_S)
        return int(report["t_ns"])

    async def _wait_routed(self, host: int) -> int:
        """Return when the discoverer had announced every peer, and complain about components that fail."""
        *others, discoverer = self._components[host]
        ready = [component.expect("ready", timeout_s=_FOREVER_S) for component in others]
        announced = asyncio.ensure_future(self._peers_announced(discoverer))
        await asyncio.gather(announced, *ready)
        return announced.result()

    async def _peers_announced(self, discoverer: LineProcess) -> int:
        found: set[str] = set()
        while True:
            event = await discoverer.expect("event", timeout_s=_FOREVER_S)
            if event["event"] == _DISCOVERED:
                found.add(event["agent"])
            if len(found) == len(self.hosts) - 1:
                return int(event["t_ns"])

    async def _start(self) -> None:
        self._stack.push_async_callback(self._close)
        for number, host in enumerate(self.hosts, start=1):
            nodes, components = await self._launch_host(number, host)
            self._nodes.append(nodes)
            self._components.append(components)
        for nodes, components in zip(self._nodes, self._components, strict=True):
            await nodes.expect("ready", timeout_s=_LOAD_S)
            for component in components:
                await component.expect("idle", timeout_s=_LOAD_S)

    async def _close(self) -> None:
        await asyncio.gather(*(process.close() for process in self._started))

    async def _launch_host(self, number: int, host: str) -> tuple[LineProcess, list[LineProcess]]:
        nodes = await self._launch(host, "nodes", ["sfglab.lab.workers.rosnodes", self._nodes_config(number)])
        components = self._component_configs(number) if self._cell.mode == ROUTED else {}
        return nodes, [
            await self._launch(host, module, ["sfglab.lab.workers.idle", module, config])
            for module, config in components.items()
        ]

    async def _launch(self, host: str, what: str, module: list[str]) -> LineProcess:
        argv = self._testbed.argv(host, [sys.executable, "-m", *module])
        process = await LineProcess.start(f"{host}, {what}", argv)
        self._started.append(process)
        return process

    def _global(self, host: str) -> BusAddress:
        return BusAddress(
            domain_id=GLOBAL_DOMAIN,
            interface=self._testbed.interface(host),
            multicast=self._config.multicast,
        )

    def _local(self, number: int) -> BusAddress:
        return BusAddress(domain_id=GLOBAL_DOMAIN + number, interface="lo")

    def _nodes_config(self, number: int) -> str:
        host = self.hosts[number - 1]
        routed = self._cell.mode == ROUTED
        address = self._local(number) if routed else self._global(host)
        config = RosNodesConfig(
            namespace=f"/{host}",
            address=address,
            talkers=self._cell.talkers,
            listeners=self._cell.listeners,
            peers=0 if routed else len(self.hosts) - 1,
        )
        return argument_of(config)

    def _component_configs(self, number: int) -> dict[str, str]:
        """Return what an agent's components are told, by module, the discoverer last."""
        host, local = self.hosts[number - 1], self._local(number)
        router = RouterConfig(agent=host, local=local, remote=self._global(host))
        # Trying accelerators belongs to another experiment, and its result does not cross here.
        status = StatusConfig(address=local, settings=StatusSettings(agent=host), detect=False)
        discoverer = DiscoveryConfig(address=local, settings=DiscoverySettings(agent=host))
        return {
            "sfglab.fleet.router.node": argument_of(router),
            "sfglab.fleet.status.node": argument_of(status),
            "sfglab.fleet.discovery.node": argument_of(discoverer),
        }


async def _within(timeout_s: float, result: Awaitable[int]) -> int | None:
    try:
        async with asyncio.timeout(timeout_s):
            return await result
    except TimeoutError:
        return None
