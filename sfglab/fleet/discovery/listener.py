"""Consumer's side of discovery events: the remote agents that are present, from a discoverer's events.

`KnownAgents` handles a discoverer that crashed and was restarted. It has no clock and no endpoints: the caller
passes events, the publisher's GID and `now_ns`.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.component import steady_ns
from sfglab.names import Resource, RosFqnBuilder, Scope
from sfglab.qos import Durability, QoSProfile

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from sfglab.bus import Node


DISCOVERY_EVENT = "sfglab_interfaces/msg/AgentDiscoveryEvent"  #: Type of discovery events.

HISTORY = 1000  #: Number of discovery events that a late joiner receives.

DISCOVERY_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=HISTORY)
"""QoS of the discoverer's publisher, which consumers should request."""

_UNKNOWN_GID = bytes(16)  # of a publisher that left before its event was read


def discovery_topic(agent: str) -> str:
    """Return the topic of an agent's discoverer: paper A, section 4.2.

    Raises:
        FqnError: The name is invalid for an agent.
    """
    return str(
        RosFqnBuilder()
        .scope(Scope.LOCAL)
        .agent(agent)
        .resource(Resource.AGENT_DISCOVERY_EVENT)
        .build()
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Offered:
    """An agent is present, and this is its current description."""

    agent: str  #: Name of the agent.
    metadata: Any  #: Description of the agent, a ``sfglab_interfaces/msg/AgentMetadata``.


@dataclass(frozen=True, slots=True, kw_only=True)
class Withdrawn:
    """An agent is no longer present: it was lost, or a new discoverer did not announce it."""

    agent: str  #: Name of the agent.


Change = Offered | Withdrawn


class KnownAgents:
    """The remote agents that are present.

    An event from a new publisher means that the discoverer was restarted. Agents that it does not announce
    within a grace period are withdrawn. The grace period covers the latched heartbeats and the queries.
    """

    def __init__(self, *, grace_ns: int = 10_000_000_000) -> None:
        #: Time at which `expire` must be called, ns; None: never.
        self.deadline_ns: int | None = None
        self._grace_ns = grace_ns
        self._publisher = _UNKNOWN_GID
        self._predecessors: set[bytes] = set()
        self._metadata: dict[str, Any] = {}
        self._unconfirmed: set[str] = set()

    def feed(self, event: Any, publisher_gid: bytes, *, now_ns: int) -> Change | None:
        """Process an ``AgentDiscoveryEvent`` and return the change.

        Returns:
            None if the event contains no news, or is from a discoverer that has been replaced.
        """
        if publisher_gid in self._predecessors:
            return None
        if publisher_gid not in (self._publisher, _UNKNOWN_GID):
            self._replace_publisher(publisher_gid, now_ns)
        self._unconfirmed.discard(event.agent)
        if not self._unconfirmed:
            self.deadline_ns = None
        if event.event == event.LOST:
            known = self._metadata.pop(event.agent, None)
            return None if known is None else Withdrawn(agent=event.agent)
        if self._metadata.get(event.agent) == event.metadata:
            return None
        self._metadata[event.agent] = event.metadata
        return Offered(agent=event.agent, metadata=event.metadata)

    def expire(self, now_ns: int) -> tuple[Withdrawn, ...]:
        """Withdraw the agents that a new discoverer did not announce, if the grace period is over."""
        if self.deadline_ns is None or now_ns < self.deadline_ns:
            return ()
        gone, self._unconfirmed, self.deadline_ns = sorted(self._unconfirmed), set(), None
        for agent in gone:
            del self._metadata[agent]
        return tuple(Withdrawn(agent=agent) for agent in gone)

    def _replace_publisher(self, gid: bytes, now_ns: int) -> None:
        if self._publisher != _UNKNOWN_GID:
            self._predecessors.add(self._publisher)
        self._publisher = gid
        self._unconfirmed = set(self._metadata)
        self.deadline_ns = now_ns + self._grace_ns if self._unconfirmed else None


async def agent_changes(node: Node, topic: str) -> AsyncIterator[Change]:
    """Subscribe to a discoverer's topic and yield all changes, those before the subscription first."""
    known = KnownAgents()
    with closing(
        node.create_subscription(DISCOVERY_EVENT, topic, qos=DISCOVERY_QOS)
    ) as subscription:
        while True:
            due_ns = known.deadline_ns
            wait_s = None if due_ns is None else max(0.0, (due_ns - steady_ns()) / 1e9)
            try:
                event, info = await subscription.take_with_info(wait_s)
            except TimeoutError:
                pass
            else:
                change = known.feed(event, info.publisher_gid, now_ns=steady_ns())
                if change is not None:
                    yield change
            for withdrawn in known.expire(steady_ns()):
                yield withdrawn
