"""Services of rmw_fastrtps at a router: those that ROS 2's program serves are events, the others a sentence."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

from sfglab.bus.api import EndpointAdded, EndpointEvent, EndpointInfo, EndpointKind, EndpointRemoved
from sfglab.bus.ros.services import RosServices, ros_gid, service_of
from sfglab.fleet.policy import Direction, Policy, Side
from sfglab.qos import History, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable


_log = logging.getLogger(__name__)


class RosHalves:
    """Passes on the first and the last of half a service's endpoints in the agent's domain as one endpoint."""

    def __init__(
        self, services: RosServices, policy: Policy, hear: Callable[[Side, EndpointEvent], None]
    ) -> None:
        self._services, self._policy, self._hear = services, policy, hear
        self._known: dict[bytes, set[bytes]] = {}
        self._refused: set[bytes] = set()

    def feed(self, side: Side, event: EndpointEvent) -> None:
        """Take an event of an endpoint in rmw_fastrtps."""
        endpoint = event.endpoint
        outward = (endpoint.kind is EndpointKind.PUBLISHER) is (side is Side.LOCAL)
        if not self._policy.crosses(endpoint.dds_topic, Direction.OUTWARD if outward else Direction.INWARD):
            return
        gid, qos = ros_gid(endpoint.dds_topic), QoSProfile(history=History.KEEP_ALL)
        one = replace(endpoint, gid=gid, participant=gid[:12], qos=qos)
        if side is Side.GLOBAL:
            self._judge(one, "it does in the domain of an agent, not in the global one")
            return
        known = self._known.setdefault(gid + endpoint.kind.value.encode(), set())
        if isinstance(event, EndpointAdded):
            known.add(endpoint.gid)
            self._services.find(endpoint.type, lambda why: self._judge(one, why) if known else None)
        else:
            known.discard(endpoint.gid)
            if not known:
                self._hear(side, EndpointRemoved(endpoint=one))

    def _judge(self, one: EndpointInfo, why: str) -> None:
        if not why:
            self._hear(Side.LOCAL, EndpointAdded(endpoint=one))
        elif one.participant not in self._refused:
            self._refused.add(one.participant)
            name = service_of(one.dds_topic)
            _log.warning("service %s of rmw_fastrtps stays here: only ROS 2 can serve it, and %s", name, why)
