"""Services of rmw_fastrtps at a router: a program of ROS 2 forwards some of them, and the router reports the others.

A client of rmw_fastrtps matches a server that frames its messages as rmw_cyclonedds does, and its request is
lost there. So where rmw_fastrtps is seen, the program runs before the first request. It also serves the services
that clients with the framing of rmw_cyclonedds call.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

from sfglab.bus.api import (
    EndpointAdded,
    EndpointEvent,
    EndpointInfo,
    EndpointKind,
    EndpointRemoved,
    entries,
)
from sfglab.bus.ros.services import RosServices, ros_gid, service_of
from sfglab.fleet.policy import Direction, Policy, Side
from sfglab.fleet.refusals import WarnOnce
from sfglab.fleet.router.plan import ROUTER_KEY
from sfglab.qos import History, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Callable


_log = logging.getLogger(__name__)


class RosHalves:
    """Combines the request and reply endpoints of a service into one endpoint.

    That endpoint appears with the first of them, and disappears with the last.

    Endpoints of other middleware pass unchanged.
    """

    def __init__(
        self, services: RosServices, policy: Policy, hear: Callable[[Side, EndpointEvent], None]
    ) -> None:
        self._services, self._policy, self._hear = services, policy, hear
        self._known: dict[bytes, set[bytes]] = {}
        self._warn = WarnOnce(_log)

    def feed(self, side: Side, event: EndpointEvent) -> None:
        """Process the discovery or the loss of an endpoint on one side of the router."""
        endpoint = event.endpoint
        framed = endpoint.transport != "ros"
        if framed:
            self._hear(side, event)
        elif side is Side.LOCAL:
            self._services.start()
        if not framed or (side is Side.LOCAL and _asks(endpoint)):
            self._serve(side, event, framed=framed)

    def _serve(self, side: Side, event: EndpointEvent, *, framed: bool) -> None:
        """Process an event of a service that the program may serve, if it may be forwarded."""
        endpoint = event.endpoint
        outward = (endpoint.kind is EndpointKind.PUBLISHER) is (side is Side.LOCAL)
        if not self._policy.crosses(
            endpoint.dds_topic, Direction.OUTWARD if outward else Direction.INWARD
        ):
            return
        gid, qos = ros_gid(endpoint.dds_topic), QoSProfile(history=History.KEEP_ALL)
        one = replace(
            endpoint, gid=gid, participant=gid[:12], qos=qos, user_data=b"", transport="ros"
        )
        if side is Side.GLOBAL:
            self._judge(one, "it does in the domain of an agent, not in the global one")
            return
        half = gid + endpoint.kind.value.encode()
        known = self._known.setdefault(half, set())

        def found(why: str) -> None:
            if known and not (framed and why):
                self._judge(one, why)

        if isinstance(event, EndpointAdded):
            known.add(endpoint.gid)
            self._services.find(endpoint.type, (half, framed), found)
        else:
            known.discard(endpoint.gid)
            if not known:
                del self._known[half]
                self._hear(side, EndpointRemoved(endpoint=one))

    def _judge(self, one: EndpointInfo, why: str) -> None:
        if not why:
            self._hear(Side.LOCAL, EndpointAdded(endpoint=one))
        else:
            service = f"service {service_of(one.dds_topic)} of rmw_fastrtps"
            self._warn(one.participant, f"{service} stays here: only ROS 2 can serve it, and {why}")


def _asks(endpoint: EndpointInfo) -> bool:
    """Return whether an endpoint belongs to a client over DDS, and not to a router on behalf of a remote client."""
    prefix = "rq/" if endpoint.kind is EndpointKind.PUBLISHER else "rr/"
    there = endpoint.transport == "dds" and endpoint.dds_topic.startswith(prefix)
    return there and ROUTER_KEY not in entries(endpoint.user_data)
