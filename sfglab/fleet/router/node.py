"""Router between an agent's domain and the global one: paper A, section 4.1, Eq. 1 and Table 1.

The module is an I/O wrapper of `plan`, in one task, on nodes of any backend. Services with the framing of
rmw_cyclonedds are forwarded unchanged. rmw_fastrtps finds the call of a reply by RTPS sample identities,
which a forwarded sample does not keep: in the agent's domain a program of ROS 2 (`sfglab.bus.ros`) calls
and answers its services and actions. Without such a program they are not forwarded.

As a process (`sfglab router`, or ``python -m sfglab.fleet.router.node CONFIG``; see `sfglab.component`) it
reports, beside ``ready``, ``{"is": "status", "paths": [...]}`` whenever paths change; a path is a
`PathStatus`. The process has no other task: a busy thread would cost milliseconds.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, cast

from sfglab.bus.api import EndpointEvent, EndpointKind, host_id
from sfglab.bus.locks import LockedError, user_lock
from sfglab.bus.parameters import Parameters
from sfglab.component import (
    Reporter,
    is_set_before,
    run_component,
    steady_ns,
)
from sfglab.errors import SfglabError
from sfglab.fleet.policy import Direction, Policy, Side
from sfglab.fleet.router.config import RouterConfig, RouterSettings
from sfglab.fleet.router.frames import Frames, TransformGate
from sfglab.fleet.router.plan import Plan
from sfglab.fleet.router.ros import RosHalves
from sfglab.fleet.router.table import CounterpartWatcher, ForwardingTable, PathStatus

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.bus import Node
    from sfglab.bus.zenoh.backend import ZenohBackend
    from sfglab.fleet.router.presence import Presence


class RouterRunningError(SfglabError, RuntimeError):
    """Another router on this host serves the agent's domain."""

    def __init__(self, domain_id: int, pid: int | None) -> None:
        self.domain_id = domain_id  #: DDS domain of the agent.
        self.pid = pid  #: Process id of the other router; None if it cannot be seen from here.
        other = "another process" if pid is None else f"process {pid}"
        super().__init__(
            f"router of domain {domain_id}: {other} on this host is already the router of this domain, "
            "and two would forward every sample twice; end the other first"
        )


@contextlib.contextmanager
def domain_lock(domain_id: int) -> Iterator[None]:
    """Hold the lock of the router of an agent's domain, among this user's routers on this host.

    The lock does not depend on the global domain: a second router would forward the agent's topics twice even if it
    led to another global domain or another middleware.

    Raises:
        RouterRunningError: Another router holds the lock.
        InvalidValueError: There is no home folder, and other users can write to the folder that replaces it.
    """
    try:
        with user_lock(f"router-{domain_id}"):
            yield
    except LockedError as error:
        raise RouterRunningError(domain_id, error.pid) from error


#: Maximum size of a message that a router's process forwards.
MAX_SAMPLE_BYTES = 64 << 20

_RESOLUTION_NS = 1_000_000


class Router:
    """Forwards topics and services that the policy lets cross, on demand, between nodes on both domains.

    Args:
        local: Node in the agent's domain.
        remote: Node in the global domain.
        settings: Settings of the router.
        tag: Name of the agent's domain among all hosts. Routers of one domain ignore each other's endpoints.
            By default the agent's name.
        on_paths: Called with all open paths whenever they change.
    """

    def __init__(
        self,
        local: Node,
        remote: Node,
        settings: RouterSettings,
        *,
        tag: str = "",
        on_paths: Callable[[tuple[PathStatus, ...]], None] = lambda _: None,
    ) -> None:
        self._nodes = {Side.LOCAL: local, Side.GLOBAL: remote}
        self._on_paths = on_paths
        policy, tag = Policy(rules=settings.rules), tag or settings.agent
        self._advertises = settings.advertise_unused_topics
        self._ros = RosHalves(local.backend.ros, policy, self._add_event)
        self._plan = Plan(
            policy,
            participants=frozenset(node.guid for node in self._nodes.values()),
            tag=tag,
            linger_ns=round(settings.idle_timeout_s * 1e9),
            advertise_unused_topics=self._advertises,
        )
        self._gate = TransformGate(_frames(settings)) if settings.prefix_frames else None
        self._table = ForwardingTable(self._nodes, tag=tag, gate=self._gate)
        self._new_presence = partial(_presence, local, remote, settings.agent, policy, tag)
        self._events: deque[tuple[Side, EndpointEvent]] = deque()
        self._woken = asyncio.Event()

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Route until cancelled, from `on_ready` on; everything it opened is closed when this returns."""
        local, remote = self._nodes[Side.LOCAL], self._nodes[Side.GLOBAL]
        counterparts = CounterpartWatcher(remote.graph, partial(self._ros.feed, Side.GLOBAL))
        presence = self._new_presence()

        def on_local(event: EndpointEvent) -> None:
            endpoint = event.endpoint
            if endpoint.participant in (local.guid, *local.backend.ros.participants):
                return
            if presence is not None and presence.feed(event):
                return
            # `on_publisher` gets all publishers of topics, so that subscriptions need no watch.
            if not (self._advertises and _is_topic(event, EndpointKind.SUBSCRIPTION)):
                counterparts.feed(event)
            self._ros.feed(Side.LOCAL, event)

        def on_publisher(event: EndpointEvent) -> None:
            if _is_topic(event, EndpointKind.PUBLISHER):
                self._ros.feed(Side.GLOBAL, event)

        ends = [local.graph.listen(on_local)]
        if self._advertises:
            ends.append(remote.graph.listen(on_publisher))
        on_ready()
        try:
            await self._route()
        finally:
            for end in ends:
                end()
            if presence is not None:
                presence.close()
            counterparts.close()
            self._table.close()

    def _add_event(self, side: Side, event: EndpointEvent) -> None:
        self._events.append((side, event))
        self._woken.set()

    async def _route(self) -> None:
        while True:
            self._woken.clear()
            events = list(self._events)
            self._events.clear()
            # Event loops count time in floats or milliseconds: a deadline counts as reached a bit earlier.
            actions = self._plan.feed(events, now_ns=steady_ns() + _RESOLUTION_NS)
            if actions:
                self._table.apply(actions)
                self._on_paths(self._table.paths)
            deadline_ns = self._plan.deadline_ns
            await is_set_before(self._woken, None if deadline_ns is None else deadline_ns / 1e9)


def _frames(settings: RouterSettings) -> Frames:
    shared, placed = frozenset(settings.shared_frames), frozenset(settings.placed_by_others)
    return Frames(agent=settings.agent, shared=shared, placed_by_others=placed)


def _presence(local: Node, remote: Node, agent: str, policy: Policy, tag: str) -> Presence | None:
    """Return the exchange of heartbeats over Zenoh; None over DDS, or if the policy does not let them cross."""
    if remote.backend.kind != "zenoh":
        return None
    from sfglab.fleet.router.presence import TOPICS, Presence

    if not all(policy.crosses(topic, way) for topic in TOPICS for way in Direction):
        return None
    return Presence(local, cast("ZenohBackend", remote.backend), agent, tag)


def _is_topic(event: EndpointEvent, kind: EndpointKind) -> bool:
    return event.endpoint.kind is kind and not event.endpoint.dds_topic.startswith(("rq/", "rr/"))


async def run_router(config: RouterConfig, report: Reporter) -> None:
    """Run a router until cancelled; everything it started has ended when this returns.

    Raises:
        RouterRunningError: This host has a router of the agent's domain.
        BusError: A domain cannot be joined.
    """
    from sfglab.bus import Node

    near = config.local.options() | {"max_sample_bytes": MAX_SAMPLE_BYTES}
    # In the global domain, routers of all agents meet.
    far = config.remote.options() | {"max_sample_bytes": MAX_SAMPLE_BYTES}
    far["namespace"] = f"/{config.agent}"

    def on_paths(paths: tuple[PathStatus, ...]) -> None:
        report({"is": "status", "paths": [asdict(path) for path in paths]})

    with domain_lock(config.local.domain_id):
        async with Node("router", **near) as local, Node("router", **far) as remote:
            tag = f"{host_id()}/{config.local.domain_id}"
            router = Router(local, remote, config, tag=tag, on_paths=on_paths)
            if config.parameters is not None:
                Parameters(local, config, config.parameters)
            await router.run(on_ready=lambda: report({"is": "ready"}))


def main() -> None:
    """Run the process until it is told to end."""
    run_component(RouterConfig, lambda config, report, _: run_router(config, report))


if __name__ == "__main__":
    main()
