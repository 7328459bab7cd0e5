"""Simulated world: hosts, domains and the nodes on them. The same seed gives the same run."""

from __future__ import annotations

import asyncio
from random import Random
from typing import TYPE_CHECKING, Literal, TypedDict, TypeVar, Unpack, get_args

from sfglab.bus.dds.domain import DomainConfig
from sfglab.bus.errors import BusError
from sfglab.bus.sim.backend import SimBackend, SimGraph, SimNode
from sfglab.bus.sim.domain import Domain, Participant
from sfglab.bus.sim.loop import VirtualLoop
from sfglab.bus.sim.network import Host, Network, Server, host_id
from sfglab.bus.sim.settings import Costs, LinkModel, ns_from_s
from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sfglab.bus.backend import Backend
    from sfglab.bus.loop import OnError

T = TypeVar("T")
Reach = Literal["network", "host"]


class NodeOptions(TypedDict, total=False):
    """Further options of `World.node`."""

    namespace: str  #: Namespace of relative topic names ("/").
    lease_s: float  #: Lease: the others remove the node after this silence (10.0).
    #: Function that receives each exception of a callback and a text that names its place.
    on_error: OnError | None
    process: str  #: Name of the process, whose nodes share its time (one process per node).


class WorldOptions(TypedDict, total=False):
    """Options of a world."""

    seed: int  #: Seed of all random draws (0).
    link: LinkModel  #: Link of every host without a link of its own.
    costs: Costs  #: Processing times of processes.


class World:
    """World of hosts on a network and the nodes on them, inside a `VirtualLoop`."""

    def __init__(self, **options: Unpack[WorldOptions]) -> None:
        loop = asyncio.get_running_loop()
        if not isinstance(loop, VirtualLoop):
            raise BusError("a world needs virtual time: use it inside run_simulated")
        self.loop = loop
        self.seed = options.get("seed", 0)
        #: Source of all random draws; components may draw from it as well.
        self.random = Random(self.seed)
        self.hosts: dict[str, Host] = {}  #: Hosts by name.
        self._costs = options.get("costs", Costs())
        self._network = Network(loop, self._costs, self.random)
        self._link = options.get("link", LinkModel())
        self._domains: dict[tuple[int, Host | None], Domain] = {}
        self._processes: dict[tuple[Host, str], Server] = {}
        self._nodes: list[SimNode] = []

    @property
    def now_ns(self) -> int:
        """Virtual time since the start, ns."""
        return self.loop.now_ns

    def host(self, name: str, link: LinkModel | None = None) -> Host:
        """Return a host, which the first call creates; without a link it has the world's."""
        if name not in self.hosts:
            id_ = host_id(self.seed, name)
            self.hosts[name] = Host(name, id_, link or self._link, self._check_cables)
        return self.hosts[name]

    def node(
        self,
        name: str,
        *,
        host: str = "host",
        domain_id: int = 0,
        reach: Reach = "network",
        **options: Unpack[NodeOptions],
    ) -> SimNode:
        """Return a started node in a domain of the network or of its host, which is created if needed.

        Raises:
            DomainError: The domain id or the lease is not allowed.
            InvalidValueError: The reach is unknown.
        """
        if reach not in get_args(Reach):
            raise InvalidValueError(f"node {name!r}: reach", reach, ", ".join(get_args(Reach)))
        config = DomainConfig(domain_id=domain_id, lease_s=options.get("lease_s", 10.0))
        where = self.host(host)
        key = (domain_id, None if reach == "network" else where)
        domain = self._domains.setdefault(key, Domain(self._network))
        number = len(self._nodes)
        process = self._process(where, options.get("process", f"node {number}"))

        def join(full_name: str, on_error: OnError | None) -> Backend:
            participant = Participant(
                domain,
                where,
                process,
                SimGraph(self.loop),
                name=full_name,
                number=number,
                lease_ns=ns_from_s(config.lease_s),
            )
            domain.join(participant)
            return SimBackend(participant, on_error)

        namespace, on_error = options.get("namespace", "/"), options.get("on_error")
        node = SimNode(name, namespace=namespace, on_error=on_error, join=join)
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

    def _process(self, host: Host, name: str) -> Server:
        process = self._processes.get((host, name))
        if process is None:
            process = self._processes[host, name] = Server()
            process.occupy(self.now_ns, ns_from_s(self._costs.start_s))
        return process

    def _check_cables(self) -> None:
        for (_, host), domain in self._domains.items():
            if host is None:
                domain.check_cables()


def run_simulated(
    main: Callable[[World], Awaitable[T]],
    *,
    limit_s: float | None = None,
    **options: Unpack[WorldOptions],
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
