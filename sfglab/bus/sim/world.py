"""Simulated world: hosts, domains and the nodes on them. The same seed gives the same run."""

from __future__ import annotations

import asyncio
import hashlib
from random import Random
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from sfglab.bus.dds.domain import DomainConfig
from sfglab.bus.errors import BusError
from sfglab.bus.graph import Graph
from sfglab.bus.node import Node
from sfglab.bus.sim.backend import SimBackend
from sfglab.bus.sim.domain import Domain, Host, Participant, Process
from sfglab.bus.sim.loop import VirtualLoop
from sfglab.bus.sim.settings import LATENCY_S, Costs, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sfglab.bus.backend import Backend

T = TypeVar("T")


class World:
    """World of hosts on a network and the nodes on them, inside a `VirtualLoop`.

    Args:
        seed: Seed of all random draws.
        latency_s: Latency of the link of every host without a latency of its own, s.
        costs: Processing times of processes.

    Raises:
        BusError: The running loop is no `VirtualLoop`.
    """

    def __init__(
        self, *, seed: int = 0, latency_s: float = LATENCY_S, costs: Costs | None = None
    ) -> None:
        loop = asyncio.get_running_loop()
        if not isinstance(loop, VirtualLoop):
            raise BusError("a world needs virtual time: use it inside run_simulated")
        self.loop = loop
        self.seed = seed
        #: Source of all random draws; components may draw from it as well.
        self.random = Random(seed)
        self._costs = costs or Costs()
        self._latency_s = latency_s
        self._hosts: dict[str, Host] = {}
        self._domains: dict[tuple[int, Host | None], Domain] = {}
        self._processes: dict[tuple[Host, str], Process] = {}
        self._nodes: list[Node] = []

    @property
    def now_ns(self) -> int:
        """Virtual time since the start, ns."""
        return self.loop.now_ns

    def host(self, name: str, latency_s: float | None = None) -> Host:
        """Return a host, which the first call creates; without a latency its link has the world's."""
        if name not in self._hosts:
            digest = hashlib.blake2b(f"{self.seed} {name}".encode(), digest_size=8)
            latency_ns = ns_from_s(self._latency_s if latency_s is None else latency_s)
            self._hosts[name] = Host(digest.hexdigest(), latency_ns)
        return self._hosts[name]

    def connect(self, host: str, *, connected: bool = True) -> None:
        """Connect a host to the network, or disconnect it: it then exchanges no packets with other hosts.

        Reliable writers send again what their readers missed, as far as they keep it. After a lease without
        connection participants lose each other.
        """
        self.host(host).is_connected = connected
        for (_, owner), domain in self._domains.items():
            if owner is None:
                domain.check_cables()

    def node(  # noqa: PLR0913 - by keyword
        self,
        name: str,
        *,
        host: str = "host",
        domain_id: int = 0,
        reach: Literal["network", "host"] = "network",
        process: str | None = None,
        lease_s: float = 10.0,
        namespace: str = "/",
    ) -> Node:
        """Return a started node in a domain of the network or of its host, which is created if needed.

        Args:
            name: Name of the node.
            host: Name of its host.
            domain_id: DDS domain, 0 to 232.
            reach: Whether the domain is the network's or the host's own.
            process: Name of its process, whose nodes share its time; None for a process of its own.
            lease_s: Lease: the others remove the node after this silence, s.
            namespace: Namespace of relative topic names.

        Raises:
            DomainError: The domain id or the lease is not allowed.
        """
        config = DomainConfig(domain_id=domain_id, lease_s=lease_s)
        where = self.host(host)
        key = (domain_id, None if reach == "network" else where)
        domain = self._domains.setdefault(key, Domain(self.loop, self._costs))
        number = len(self._nodes)
        runs_in = self._process(where, process or f"node {number}")

        def join(full_name: str) -> Backend:
            participant = Participant(
                domain,
                where,
                runs_in,
                Graph(self.loop),
                name=full_name,
                number=number,
                lease_ns=ns_from_s(config.lease_s),
            )
            domain.join(participant)
            return SimBackend(participant, self.random)

        node = Node(name, namespace=namespace, join=join)
        node.start()
        self._nodes.append(node)
        return node

    def announced(self) -> int:
        """Return the number of endpoints announced so far in domain 0 of the network."""
        return self._domains[0, None].announced

    def close(self) -> None:
        """Close all nodes."""
        for node in self._nodes:
            node.destroy_node()

    def _process(self, host: Host, name: str) -> Process:
        process = self._processes.get((host, name))
        if process is None:
            process = self._processes[host, name] = Process()
            process.occupy(self.now_ns, ns_from_s(self._costs.start_s))
        return process


def run_simulated(
    main: Callable[[World], Awaitable[T]], *, limit_s: float | None = None, **options: Any
) -> T:
    """Run a coroutine function in a new world with options of `World`, and return its result.

    Inside, `asyncio.sleep`, `timeout`, `loop.time` and timers use virtual time: they take no real time.

    Raises:
        DeadlockError: All tasks wait and nothing is scheduled.
        TimeLimitError: The function did not end within `limit_s` of virtual time; None for no limit.
    """

    async def body() -> T:
        world = World(**options)
        try:
            return await main(world)
        finally:
            world.close()

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(limit_s)) as runner:
        return runner.run(body())
