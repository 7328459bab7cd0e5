"""Computation graph of one node: endpoints by topic, and events when they appear and disappear."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sfglab.bus.api import EndpointAdded, EndpointKind, EndpointRemoved
from sfglab.bus.loop import Signal

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterable

    from sfglab.bus.api import EndpointEvent, EndpointInfo, Listener, NodeInfo


class Graph:
    """Graph of all endpoints of the node's domain, including its own, on the node's loop.

    Discovery runs in the background: wait with `wait_for`, or `listen` to changes. The first call of `nodes`
    calls `read_nodes`, which lets `learn_nodes` be called from then on.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, read_nodes: Callable[[], None] = lambda: None
    ) -> None:
        self._read_nodes: Callable[[], None] | None = read_nodes
        self._nodes: dict[bytes, tuple[NodeInfo, ...]] = {}
        self._owners: dict[bytes, str] = {}
        self._endpoints: dict[bytes, EndpointInfo] = {}
        self._listeners: list[Listener] = []
        self._changed = Signal(loop)

    def publishers(self, topic: str) -> tuple[EndpointInfo, ...]:
        """Return the publishers of a ROS topic, ordered by GID."""
        return self._select(topic, EndpointKind.PUBLISHER)

    def subscriptions(self, topic: str) -> tuple[EndpointInfo, ...]:
        """Return the subscriptions of a ROS topic, ordered by GID."""
        return self._select(topic, EndpointKind.SUBSCRIPTION)

    def endpoints(self) -> tuple[EndpointInfo, ...]:
        """Return all known endpoints, ordered by GID."""
        self._ask()
        return self._known()

    def topics(self) -> dict[str, tuple[str, ...]]:
        """Return the types of every topic, both sorted; more than one type is a conflict."""
        self._ask()
        return types_by_topic(self._endpoints.values())

    def nodes(self) -> tuple[NodeInfo, ...]:
        """Return the nodes of ROS 2's graph, ordered by name.

        Nodes are read from the first call on: wait with `wait_for`. From then on `EndpointInfo.node` also names
        owners outside sfglab.
        """
        if self._read_nodes is not None:
            read, self._read_nodes = self._read_nodes, None
            read()
        found = [node for nodes in self._nodes.values() for node in nodes]
        return tuple(sorted(found, key=lambda node: (node.full_name, node.participant)))

    async def wait_for(self, predicate: Callable[[], bool], timeout_s: float = 5.0) -> bool:
        """Return True once a predicate over this graph holds, False if it does not within `timeout_s`."""
        return await self._changed.wait_until(predicate, timeout_s)

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call `listener` for every known endpoint and every change; return a function that stops this."""
        self._ask()
        return self._follow(listener)

    def watch(self, dds_topic: str, kind: EndpointKind, listener: Listener) -> Callable[[], None]:
        """Call `listener` as `listen` does, but only for endpoints of one kind on one DDS topic."""

        def heard(event: EndpointEvent) -> None:
            if event.endpoint.dds_topic == dds_topic and event.endpoint.kind is kind:
                listener(event)

        self._ask(dds_topic, kind)
        return self._follow(heard)

    def apply(self, changes: Iterable[tuple[bytes, EndpointInfo | None]]) -> None:
        """Apply discovered changes; None means that the endpoint or participant has left."""
        for gid, endpoint in changes:
            known = self._endpoints.get(gid)
            if endpoint is None:
                self._forget_nodes(gid)
                if known is not None:
                    del self._endpoints[gid]
                    self._tell(EndpointRemoved(endpoint=known))
            elif (owned := self._owned(endpoint)) != known:
                self._endpoints[gid] = owned
                self._tell(EndpointAdded(endpoint=owned))
        self._changed.notify()

    def learn_nodes(self, participant: bytes, nodes: tuple[NodeInfo, ...]) -> None:
        """Replace the complete list of a participant's nodes."""
        self._forget_nodes(participant)
        self._nodes[participant] = nodes
        owners = {gid: node.full_name for node in nodes for gid in (*node.readers, *node.writers)}
        self._owners |= owners
        self.apply([(gid, self._endpoints[gid]) for gid in owners if gid in self._endpoints])

    def _ask(self, dds_topic: str = "", kind: EndpointKind | None = None) -> None:
        """Discover endpoints of one kind on one DDS topic, or all; by default all are discovered unasked."""

    def _known(self) -> tuple[EndpointInfo, ...]:
        return tuple(self._endpoints[gid] for gid in sorted(self._endpoints))

    def _follow(self, listener: Listener) -> Callable[[], None]:
        for endpoint in self._known():
            listener(EndpointAdded(endpoint=endpoint))
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def _forget_nodes(self, participant: bytes) -> None:
        for node in self._nodes.pop(participant, ()):
            for gid in (*node.readers, *node.writers):
                self._owners.pop(gid, None)

    def _owned(self, endpoint: EndpointInfo) -> EndpointInfo:
        owner = "" if endpoint.node else self._owners.get(endpoint.gid, "")
        return replace(endpoint, node=owner) if owner else endpoint

    def _tell(self, event: EndpointEvent) -> None:
        for listener in tuple(self._listeners):
            listener(event)

    def _select(self, topic: str, kind: EndpointKind) -> tuple[EndpointInfo, ...]:
        self._ask(f"rt{topic}" if topic.startswith("/") else topic, kind)
        return tuple(e for e in self._known() if e.topic == topic and e.kind is kind)


def types_by_topic(endpoints: Iterable[EndpointInfo]) -> dict[str, tuple[str, ...]]:
    """Return the types of every topic of some endpoints, both sorted."""
    found: dict[str, set[str]] = {}
    for endpoint in endpoints:
        found.setdefault(endpoint.topic, set()).add(endpoint.type)
    return {topic: tuple(sorted(found[topic])) for topic in sorted(found)}
