"""Which endpoints of the global domain a router has to hear of: those that meet an endpoint of its own agent.

A fleet of n agents has some n * n endpoints in the global domain, since each asks each other what it is.
A router that looked at all of them would spend most of its time on what does not concern its agent. Knows
graphs; refuses to know policies and paths.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from sfglab.bus.api import EndpointAdded, EndpointKind, EndpointRemoved

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Graph
    from sfglab.bus.api import EndpointEvent, EndpointInfo


_OTHER = {
    EndpointKind.PUBLISHER: EndpointKind.SUBSCRIPTION,
    EndpointKind.SUBSCRIPTION: EndpointKind.PUBLISHER,
}
_Topic = tuple[str, EndpointKind]


@dataclass(slots=True)
class _Watch:
    end: Callable[[], None]
    here: set[bytes] = field(default_factory=set)
    there: dict[bytes, EndpointInfo] = field(default_factory=dict)


class Interest:
    """Watches in one domain the counterparts of what another has.

    Args:
        graph: Of the domain that is watched.
        hear: Given what happens there to counterparts, and that they have gone when nothing here meets them
            any more.
    """

    def __init__(self, graph: Graph, hear: Callable[[EndpointEvent], None]) -> None:
        self._graph = graph
        self._hear = hear
        self._watches: dict[_Topic, _Watch] = {}

    def feed(self, event: EndpointEvent) -> None:
        """Take an event of the other domain: an endpoint whose counterparts matter, or do not any more."""
        endpoint = event.endpoint
        topic = (endpoint.dds_topic, _OTHER[endpoint.kind])
        if isinstance(event, EndpointAdded):
            self._watch(topic).here.add(endpoint.gid)
        elif (watch := self._watches.get(topic)) is not None:
            watch.here.discard(endpoint.gid)
            if not watch.here:
                self._forget(topic, watch)

    def close(self) -> None:
        """Watch nothing any more; again is harmless."""
        for watch in self._watches.values():
            watch.end()
        self._watches.clear()

    def _watch(self, topic: _Topic) -> _Watch:
        if topic not in self._watches:
            watch = self._watches[topic] = _Watch(end=lambda: None)
            watch.end = self._graph.watch(*topic, partial(self._heard, watch))
        return self._watches[topic]

    def _heard(self, watch: _Watch, event: EndpointEvent) -> None:
        if isinstance(event, EndpointAdded):
            watch.there[event.endpoint.gid] = event.endpoint
        else:
            watch.there.pop(event.endpoint.gid, None)
        self._hear(event)

    def _forget(self, topic: _Topic, watch: _Watch) -> None:
        del self._watches[topic]
        watch.end()
        for endpoint in watch.there.values():
            self._hear(EndpointRemoved(endpoint=endpoint))
