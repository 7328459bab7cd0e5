"""Says aloud when a publisher of a subscription's topic will never reach it, and why.

Types that differ and requests beyond what is offered are silent in DDS: nothing arrives. ROS 2 warns, and so
do we, once for each publisher.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from sfglab.bus.api import EndpointAdded, EndpointKind
from sfglab.qos import incompatibilities

if TYPE_CHECKING:
    from sfglab.bus.api import EndpointEvent, EndpointInfo, Transport
    from sfglab.bus.graph import Graph
    from sfglab.bus.transports import Target


_log = logging.getLogger("sfglab.bus")


class MismatchWatch:
    """Watches the graph on behalf of one subscription.

    Args:
        graph: What the node knows.
        target: What the subscription wants.
        transport: How.
    """

    def __init__(self, graph: Graph, target: Target, transport: Transport) -> None:
        self._target = target
        self._transport = transport
        self._warned: set[bytes] = set()
        self._unlisten = graph.listen(self._look)

    def close(self) -> None:
        """End watching; again is harmless."""
        self._unlisten()

    def _look(self, event: EndpointEvent) -> None:
        endpoint = event.endpoint
        if endpoint.kind is not EndpointKind.PUBLISHER or endpoint.topic != self._target.topic:
            return
        if not isinstance(event, EndpointAdded):
            self._warned.discard(endpoint.gid)
            return
        reasons = self._reasons(endpoint)
        if reasons and endpoint.gid not in self._warned:
            self._warned.add(endpoint.gid)
            who = f"node {endpoint.node!r}" if endpoint.node else "another process"
            _log.warning(
                "topic %r: nothing will arrive from a publisher of %s: %s",
                endpoint.topic,
                who,
                "; ".join(reasons),
            )

    def _reasons(self, endpoint: EndpointInfo) -> tuple[str, ...]:
        if endpoint.transport != self._transport:
            return ()  # the two transports do not meet on purpose
        if endpoint.type != self._target.type:
            return (f"type: the reader wants {self._target.type}, the writer has {endpoint.type}",)
        return incompatibilities(offered=endpoint.qos, requested=self._target.qos)
