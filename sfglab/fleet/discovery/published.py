"""Descriptions that agents publish on a latched topic: the answer to a query without a service call.

All agents share one topic for their descriptions, as they do for heartbeats. In a fleet of n agents these are
2 n endpoints in the global domain; services for all of them are 2 n^2 + 2 n. Any participant can publish on the
topic. Therefore a published description only answers a query, it is validated like any other, and it is not
used if two publishers describe one agent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.fleet.discovery.validation import MAX_METADATA_BYTES, Rates, Refusal
from sfglab.fleet.status.heartbeat import AGENT_METADATA
from sfglab.messages import CdrError, deserialize

if TYPE_CHECKING:
    from collections.abc import Callable


class PublishedDescriptions:
    """Last description of each publisher. The number of publishers is limited."""

    def __init__(self, max_publishers: int) -> None:
        self._max_publishers = max_publishers
        self._rates = Rates(2 * max_publishers)
        self._last: dict[bytes, Any] = {}  # by publisher, the most recent last

    def receive(self, cdr: bytes, publisher_gid: bytes, *, now_ns: int) -> Refusal | None:
        """Store a serialized ``AgentMetadata`` and return None, or return why it is dropped."""
        if not self._rates.take(publisher_gid, now_ns):
            return Refusal.FLOOD
        if len(cdr) > MAX_METADATA_BYTES:
            return Refusal.MALFORMED
        try:
            metadata = deserialize(cdr, AGENT_METADATA)
        except CdrError:
            return Refusal.MALFORMED
        self._last.pop(publisher_gid, None)
        self._last[publisher_gid] = metadata
        if len(self._last) > self._max_publishers:
            del self._last[next(iter(self._last))]
        return None

    def find(self, agent: str, wanted: tuple[int, int], is_there: Callable[[bytes], bool]) -> Any:
        """Return an agent's ``AgentMetadata`` if exactly one publisher describes the agent, else None.

        Args:
            agent: Name of the agent.
            wanted: Oldest incarnation and revision that are acceptable.
            is_there: Whether a publisher still exists. It is called if there are several.
        """
        publishers = [gid for gid, metadata in self._last.items() if metadata.agent == agent]
        if len(publishers) > 1:
            publishers = [gid for gid in publishers if is_there(gid)]
        if len(publishers) != 1:
            return None
        metadata = self._last[publishers[0]]
        return metadata if (metadata.incarnation, metadata.revision) >= wanted else None
