"""Who on this device wants what: local subscriptions of decoded topics, seen in the graph.

Paper A, section 4.3, Fig. 4: the decoder monitors graph events to track local subscriptions. Knows graph
events and topics; refuses to know pipelines, processes and clocks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.bus.api import EndpointAdded, EndpointKind

if TYPE_CHECKING:
    from sfglab.bus.api import EndpointEvent, Transport


class Demand:
    """The local subscriptions of all topics, by topic and transport."""

    def __init__(self) -> None:
        self._subscriptions: dict[str, dict[bytes, Transport]] = {}

    def feed(self, event: EndpointEvent) -> str | None:
        """Take one graph event.

        Args:
            event: An endpoint that appeared, changed or went.

        Returns:
            The topic whose demand may have changed; None for events that are no subscription's.
        """
        endpoint = event.endpoint
        if endpoint.kind is not EndpointKind.SUBSCRIPTION:
            return None
        known = self._subscriptions.setdefault(endpoint.topic, {})
        if isinstance(event, EndpointAdded):
            known[endpoint.gid] = endpoint.transport
        else:
            known.pop(endpoint.gid, None)
        if not known:
            del self._subscriptions[endpoint.topic]
        return endpoint.topic

    def transports(self, topic: str) -> frozenset[Transport]:
        """Return the transports by which a topic is wanted; empty when nobody subscribes."""
        return frozenset(self._subscriptions.get(topic, {}).values())

    def count(self, topic: str) -> int:
        """Return how many local subscriptions a topic has."""
        return len(self._subscriptions.get(topic, {}))
