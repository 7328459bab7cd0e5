"""The simulated world: hosts, links, domains and faults. The same seed gives the same run, to the byte."""

from __future__ import annotations

import asyncio
from random import Random
from typing import TYPE_CHECKING, Literal, TypedDict, TypeVar, Unpack, get_args

from sfglab.bus.api import HOST_KEY, NODE_KEY, user_data
from sfglab.bus.dds.domain import DomainConfig
from sfglab.bus.errors import BusError
from sfglab.bus.sim.accounts import Accounts
from sfglab.bus.sim.backend import Fabric, SimBackend, SimNode
from sfglab.bus.sim.discovery import Discovery
from sfglab.bus.sim.loop import VirtualLoop
from sfglab.bus.sim.model import (
    Domain,
    Environment,
    Host,
    Participant,
    Partition,
    Process,
    new_host,
)
from sfglab.bus.sim.network import Network, Services
from sfglab.bus.sim.settings import ANNOUNCEMENT_SHARE, Costs, LinkModel, ns_from_s
from sfglab.bus.sim.views import Views
from sfglab.bus.sim.wire import HostTraffic, KindBytes
from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from sfglab.bus.backend import Backend
    from sfglab.bus.loop import OnError

T = TypeVar("T")
Reach = Literal["network", "host"]


class NodeOptions(TypedDict, total=False):
    """What else a node can be given; see `World.node`."""

    namespace: str  #: Where relative topic names live ("/").
    lease_s: float  #: After how long a silence the others give it up (10.0).
    #: Given every exception of a callback and a text that names its place.
    on_error: OnError | None
    process: str  #: Nodes of one process share its time (one of its own).
    #: Whether ROS 2's tools shall see it as a node, which takes one more writer (True).
    discovery_info: bool


class WorldOptions(TypedDict, total=False):
    """How a world is made."""

    seed: int  #: Decides everything that is left to chance (0).
    link: LinkModel  #: The link of every host that has none of its own.
    costs: Costs  #: How long processes take for what they hear.
    #: Whether announcements, and samples for more than one other host, go by multicast (True).
    multicast: bool
    #: Hand a service's reply only to the participant that asked, not to all who have a client of that service
    #: and would ignore it (False). Bytes are accounted, and costs charged, as if all had got it: without this,
    #: n clients of n services cost n**3 deliveries.
    lean_services: bool


class World(Environment):
    """Hosts on a network, and the nodes on them; inside a `VirtualLoop`."""

    def __init__(self, **options: Unpack[WorldOptions]) -> None:
        loop = asyncio.get_running_loop()
        if not isinstance(loop, VirtualLoop):
            raise BusError("a world needs virtual time: use it inside run_simulated")
        super().__init__(loop, options.get("costs", Costs()))
        self.seed = options.get("seed", 0)
        #: Draws what is left to chance; components may draw from it too.
        self.random = Random(self.seed)
        self.hosts: dict[str, Host] = {}  #: By name.
        self._views = Views(loop, self.seed)
        self._network = Network(loop, self.costs, self.random)
        services = Services() if options.get("lean_services") else None
        self._fabric = Fabric(self._network, services, self.random)
        self._multicast = options.get("multicast", True)
        self._link = options.get("link", LinkModel())
        self._domains: dict[tuple[int, Host | None], Discovery] = {}
        self._processes: dict[tuple[Host, str], Process] = {}
        self._nodes: dict[SimNode, None] = {}

    def host(self, name: str, link: LinkModel | None = None) -> Host:
        """Return a host, made if there is none yet; without a link it keeps its own, or has the world's."""
        host = self.hosts.get(name)
        if host is None:
            self._settle()  # what was sent so far did not reach it
            host = self.hosts[name] = new_host(name, self._link, self.seed)
            self._network.note(self._link)
        if link is not None:
            self.set_link(name, link)
        return host

    def node(
        self,
        name: str,
        *,
        host: str = "host",
        domain_id: int = 0,
        reach: Reach = "network",
        **options: Unpack[NodeOptions],
    ) -> SimNode:
        """Return a started node on a host, made if need be, in a domain of the network or the host's own.

        Raises:
            DomainError: There can be no such domain.
            InvalidValueError: There is no such reach.
        """
        if reach not in get_args(Reach):
            raise InvalidValueError(f"node {name!r}: reach", reach, ", ".join(get_args(Reach)))
        config = DomainConfig(domain_id=domain_id, lease_s=options.get("lease_s", 10.0))
        where = self.host(host)
        discovery = self._domain(domain_id, None if reach == "network" else where)

        def join(full_name: str, on_error: OnError | None) -> Backend:
            participant = self._participant(
                full_name, where, discovery.domain, config.lease_s, options
            )
            discovery.join(participant)
            return SimBackend(participant, discovery, self._fabric, on_error)

        namespace, on_error = options.get("namespace", "/"), options.get("on_error")
        node = SimNode(name, namespace=namespace, on_error=on_error, join=join)
        node.start()
        self._nodes[node] = None
        return node

    def set_link(self, host: str, link: LinkModel) -> None:
        """Change a host's link for what is sent from now on; discovery goes by the link at the node's start."""
        self.host(host).set_link(link)
        self._network.note(link)
        self._reroute()

    def partition(self, *groups: set[str]) -> None:
        """Cut the network into groups of hosts that do not hear each other; those not named are one more.

        Raises:
            BusError: It is cut already.
            InvalidValueError: A host is named twice.
        """
        partitions = self._views.partitions
        if partitions and partitions[-1].lasts:
            raise BusError("partition: the network is cut already; heal it first")
        sides: dict[Host, int] = {}
        for number, group in enumerate(groups, start=1):
            for name in sorted(group):
                if self.host(name) in sides:
                    raise InvalidValueError(
                        "partition: a host in two groups", name, "one group for each"
                    )
                sides[self.host(name)] = number
        self._settle()
        self._set_sides(sides)
        partitions.append(Partition(self.loop.now_ns, sides))
        self._note("part", b"", repr([sorted(group) for group in groups]).encode())
        for discovery, one, other in self._apart(partitions[-1]):
            self.loop.at(self.loop.now_ns + other.lease_ns, discovery.review, one, other)

    def heal(self) -> None:
        """Join the network again; harmless if it is whole."""
        partitions = self._views.partitions
        if not partitions or not partitions[-1].lasts:
            return
        self._settle()
        self._set_sides({})
        partitions[-1].end_ns = self.loop.now_ns
        self._note("heal", b"", b"")
        for discovery, one, other in self._apart(partitions[-1]):
            # Now too: news that were due at this very instant have arrived after all.
            for time_ns in (self.loop.now_ns, self._views.gaps(one, other)[-1].back_ns):
                self.loop.at(time_ns, discovery.review, one, other)

    def traffic(self) -> dict[str, HostTraffic]:
        """Return what each host's interface to the network has carried so far, by host name."""
        self._settle()
        return {
            name: HostTraffic(rx=KindBytes.of(host.rx), tx=KindBytes.of(host.tx))
            for name, host in self.hosts.items()
        }

    def received(self, host: str) -> int:
        """Return how many bytes a host's interface has received so far; cheaper than `traffic`."""
        counted = self.host(host)
        domains = [d for (_, local), d in self._domains.items() if local is None]
        return sum(counted.rx) + sum(discovery.accounts.pending_rx() for discovery in domains)

    def announced(self) -> int:
        """Return how many endpoints domain 0 of the network has had so far."""
        return self._domain(0, None).domain.announced

    def close(self) -> None:
        """Close all nodes."""
        for node in self._nodes:
            node.destroy_node()

    def _domain(self, domain_id: int, host: Host | None) -> Discovery:
        key = (domain_id, host)
        if key not in self._domains:
            domain = Domain(self, networked=host is None)
            accounts = Accounts(domain, self.hosts, multicast=self._multicast)
            self._domains[key] = Discovery(domain, accounts, self._views, self._network)
        return self._domains[key]

    def _participant(
        self, full_name: str, host: Host, domain: Domain, lease_s: float, options: NodeOptions
    ) -> Participant:
        process = self._process(host, options.get("process", f"node {self.new_number()}"))
        return Participant(
            domain,
            host,
            process,
            name=full_name,
            number=self.new_number(),
            user_data=user_data({"enclave": "/", NODE_KEY: full_name, HOST_KEY: host.id}),
            discovery_info=options.get("discovery_info", True),
            lease_ns=ns_from_s(lease_s),
            interval_ns=ns_from_s(lease_s * ANNOUNCEMENT_SHARE),
        )

    def _process(self, host: Host, name: str) -> Process:
        if (host, name) not in self._processes:
            self._processes[host, name] = Process()
            self._processes[host, name].occupy(self.loop.now_ns, ns_from_s(self.costs.start_s))
        return self._processes[host, name]

    def _apart(self, partition: Partition) -> list[tuple[Discovery, Participant, Participant]]:
        """Return the ordered pairs of participants that a partition separates."""
        return [
            (discovery, one, other)
            for (_, host), discovery in self._domains.items()
            if host is None
            for one in discovery.domain.members
            for other in discovery.domain.members
            if partition.separates(one, other)
        ]

    def _set_sides(self, sides: dict[Host, int]) -> None:
        for host in self.hosts.values():
            host.side = sides.get(host, 0)
        for discovery in self._domains.values():
            discovery.accounts.parted = bool(sides)
        self._network.varies = True  # from now on every packet is looked at
        self._reroute()

    def _reroute(self) -> None:
        for discovery in self._domains.values():
            for topic in discovery.domain.topics.values():
                for writer in topic.writers:
                    writer.reroute()

    def _settle(self) -> None:
        for discovery in self._domains.values():
            discovery.settle()

    def _note(self, what: str, gid: bytes, data: bytes) -> None:
        if self.trace is not None:
            self.trace(what, gid, data)


def run_simulated(
    main: Callable[[World], Awaitable[T]],
    *,
    limit_s: float | None = None,
    **options: Unpack[WorldOptions],
) -> T:
    """Run a coroutine function in a world of its own, with options of `World`, and return its result.

    Inside, `asyncio.sleep`, `timeout`, `loop.time` and timers are virtual: they take no time, only order.

    Raises:
        DeadlockError: Everybody waits and nothing is scheduled.
        TimeLimitError: It was not done at `limit_s` of virtual time; None: there is no limit.
    """

    async def body() -> T:
        world = World(**options)
        try:
            return await main(world)
        finally:
            world.close()

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(limit_s)) as runner:
        return runner.run(body())
