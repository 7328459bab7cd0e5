"""The computation graph as one simulated node sees it.

Answers questions from the domain's indices and the node's view, and becomes a listener of every event only
while somebody listens to all of them: thousands of nodes that watch a few topics cost what these cost.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab import names
from sfglab.bus.api import EndpointKind, NodeInfo
from sfglab.bus.graph import Graph
from sfglab.bus.sim.domain import Watch

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterable

    from sfglab.bus.api import EndpointEvent, EndpointInfo
    from sfglab.bus.sim.endpoint import Endpoint
    from sfglab.bus.sim.participant import Participant


class SimGraph(Graph):
    """All endpoints that a participant knows of, its own included.

    Args:
        participant: Whose view it is.
    """

    def __init__(self, participant: Participant) -> None:
        super().__init__(participant.domain.world.loop)
        self.participant = participant
        self._domain = participant.domain
        self._views = participant.domain.world.views
        self._users = 0

    def publishers(self, topic: str) -> tuple[EndpointInfo, ...]:
        """Return the publishers of a ROS topic, ordered by gid."""
        return self._of_topic(topic, EndpointKind.PUBLISHER)

    def subscriptions(self, topic: str) -> tuple[EndpointInfo, ...]:
        """Return the subscriptions of a ROS topic, ordered by gid."""
        return self._of_topic(topic, EndpointKind.SUBSCRIPTION)

    def endpoints(self) -> tuple[EndpointInfo, ...]:
        """Return all known endpoints, ordered by gid."""
        return self._known(self._domain.endpoints())

    def topics(self) -> dict[str, tuple[str, ...]]:
        """Return the types of every topic, both sorted; more than one type is a conflict."""
        found: dict[str, set[str]] = {}
        for endpoint in self.endpoints():
            found.setdefault(endpoint.topic, set()).add(endpoint.type)
        return {topic: tuple(sorted(found[topic])) for topic in sorted(found)}

    def nodes(self) -> tuple[NodeInfo, ...]:
        """Return the nodes that have endpoints here, ordered by name."""
        gids: dict[tuple[str, bytes], tuple[list[bytes], list[bytes]]] = {}
        for endpoint in self.endpoints():
            readers, writers = gids.setdefault((endpoint.node, endpoint.participant), ([], []))
            (writers if endpoint.kind is EndpointKind.PUBLISHER else readers).append(endpoint.gid)
        return tuple(
            NodeInfo(
                namespace=name.rpartition("/")[0] or "/",
                name=name.rpartition("/")[2],
                participant=participant,
                readers=tuple(readers),
                writers=tuple(writers),
            )
            for (name, participant), (readers, writers) in sorted(gids.items())
        )

    async def events(self) -> AsyncIterator[EndpointEvent]:
        """Yield an `EndpointAdded` for every endpoint known now, then every change until the node closes."""
        self._attach()
        try:
            async for event in super().events():
                yield event
        finally:
            self._detach()

    async def wait_for(self, predicate: Callable[[], bool], timeout_s: float = 5.0) -> bool:
        """Return True once a predicate over this graph holds, False when it did not within `timeout_s`."""
        self._attach()
        try:
            return await super().wait_for(predicate, timeout_s)
        finally:
            self._detach()

    def listen(self, listener: Callable[[EndpointEvent], None]) -> Callable[[], None]:
        """Call `listener` for every endpoint known now and every change; return what ends that."""
        self._attach()
        unlisten = super().listen(listener)
        ended = False

        def end() -> None:
            nonlocal ended
            unlisten()
            if not ended:
                ended = True
                self._detach()

        return end

    def watch(
        self, dds_topic: str, kind: EndpointKind, listener: Callable[[EndpointEvent], None]
    ) -> Callable[[], None]:
        """Call `listener` as `listen` does, but only for endpoints of one kind on one topic of the wire."""
        watch = Watch(self.participant, listener)
        return self._domain.watch(watch, dds_topic, writers=kind is EndpointKind.PUBLISHER)

    def learn(self, endpoint: Endpoint) -> None:
        """Tell the listeners of an endpoint."""
        self.apply([(endpoint.gid, endpoint.info)])

    def forget(self, endpoint: Endpoint) -> None:
        """Tell the listeners that an endpoint has gone."""
        self.apply([(endpoint.gid, None)])

    def _attach(self) -> None:
        self._users += 1
        if self._users == 1:
            self._domain.graphs[self] = None
            self._domain.show(self, sorted(self._domain.endpoints(), key=lambda e: e.gid))

    def _detach(self) -> None:
        self._users -= 1
        if not self._users:
            self._domain.graphs.pop(self, None)
            self._endpoints.clear()

    def _of_topic(self, topic: str, kind: EndpointKind) -> tuple[EndpointInfo, ...]:
        try:
            dds_topic = names.dds_topic(topic)
        except names.FqnError:
            dds_topic = topic
        index = self._domain.topics.get(dds_topic)
        return () if index is None else self._known(e for e in index.endpoints() if e.info.kind is kind)

    def _known(self, endpoints: Iterable[Endpoint]) -> tuple[EndpointInfo, ...]:
        knows, participant = self._views.knows, self.participant
        return tuple(sorted((e.info for e in endpoints if knows(participant, e)), key=lambda i: i.gid))
