"""The consumer's side of discovery events: which remote agents there are, folded from what the discoverer says.

`KnownAgents` survives a discoverer that crashed and was started again. Pure: the caller passes messages, the
publisher's gid and `now_ns`.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.component import steady_ns
from sfglab.names import Resource, RosFqnBuilder, Scope
from sfglab.qos import Durability, QoSProfile

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Mapping

    from sfglab.bus import Node


DISCOVERY_EVENT = "sfglab_interfaces/msg/AgentDiscoveryEvent"  #: The type of discovery events.

HISTORY = 1000  #: How many discovery events a consumer that comes late still hears.

DISCOVERY_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=HISTORY)
"""What the discoverer offers and a consumer should request."""

_NOBODY = bytes(16)  # the gid of a publisher that was gone before its event was read


def discovery_topic(agent: str) -> str:
    """Return where an agent's discoverer publishes (paper A, 4.2); `FqnError` if no agent can bear the name."""
    return str(
        RosFqnBuilder()
        .scope(Scope.LOCAL)
        .agent(agent)
        .resource(Resource.AGENT_DISCOVERY_EVENT)
        .build()
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Offered:
    """An agent is there, and this is what it offers from now on."""

    agent: str  #: Its name.
    metadata: Any  #: Its description, a ``sfglab_interfaces/msg/AgentMetadata``.


@dataclass(frozen=True, slots=True, kw_only=True)
class Withdrawn:
    """An agent is not there any more."""

    agent: str  #: Its name.


Change = Offered | Withdrawn


class KnownAgents:
    """The remote agents that are there now.

    An event of a new publisher means that the discoverer was started again: agents that it does not announce
    within a grace period, which covers hearing the last heartbeats and asking, are withdrawn.
    """

    def __init__(self, *, grace_ns: int = 10_000_000_000) -> None:
        self.deadline_ns: int | None = None  #: When `expire` has to be called; None: no wait.
        self._grace_ns = grace_ns
        self._publisher = _NOBODY
        self._predecessors: set[bytes] = set()
        self._metadata: dict[str, Any] = {}
        self._unconfirmed: set[str] = set()

    @property
    def agents(self) -> Mapping[str, Any]:
        """The descriptions of the agents that are there, by name."""
        return dict(self._metadata)

    def feed(self, event: Any, publisher_gid: bytes, *, now_ns: int) -> Change | None:
        """Take an ``AgentDiscoveryEvent`` and its publisher; return what changed.

        None when the event says what is known, or comes from a discoverer that has since been replaced.
        """
        if publisher_gid in self._predecessors:
            return None
        if publisher_gid not in (self._publisher, _NOBODY):
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
        """Withdraw what a new discoverer has not announced within the grace period, if that is over."""
        if self.deadline_ns is None or now_ns < self.deadline_ns:
            return ()
        gone, self._unconfirmed, self.deadline_ns = sorted(self._unconfirmed), set(), None
        for agent in gone:
            del self._metadata[agent]
        return tuple(Withdrawn(agent=agent) for agent in gone)

    def _replace_publisher(self, gid: bytes, now_ns: int) -> None:
        if self._publisher != _NOBODY:
            self._predecessors.add(self._publisher)
        self._publisher = gid
        self._unconfirmed = set(self._metadata)
        self.deadline_ns = now_ns + self._grace_ns if self._unconfirmed else None


async def agent_changes(node: Node, topic: str) -> AsyncIterator[Change]:
    """Yield every change of what remote agents offer on a discoverer's topic, what it said before first."""
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
