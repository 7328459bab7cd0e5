"""Descriptions that agents offer unasked: which one answers a query, and when their service has to be asked.

All agents' descriptions, latched, share one topic, as their heartbeats do: in a fleet of n that is 2 n
endpoints in the global domain, where asking each other's services takes 2 n^2 + 2 n. Anybody can publish there:
an offer only answers a query and is checked as any, and where two speak for one agent neither is believed.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING, Any

from sfglab.fleet.discovery.screening import Limits, Rates, Refusal

if TYPE_CHECKING:
    from collections.abc import Callable


class Offers:
    """The last description of each publisher, of at most `Limits.max_agents` that spoke last."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._rates = Rates(limits)
        self._last: OrderedDict[bytes, Any] = OrderedDict()

    def heard(self, cdr_bytes: int, publisher: bytes, *, now_ns: int) -> Refusal | None:
        """Return why a description of so many bytes is not looked at, or None if it is; then `take` it."""
        if not self._rates.take(publisher, now_ns):
            return Refusal.FLOOD
        return Refusal.MALFORMED if cdr_bytes > self._limits.max_metadata_bytes else None

    def take(self, metadata: Any, publisher: bytes) -> None:
        """Keep an ``AgentMetadata``, which may say anything."""
        self._last[publisher] = metadata
        self._last.move_to_end(publisher)
        if len(self._last) > self._limits.max_agents:
            self._last.popitem(last=False)

    def of(self, agent: str, wanted: tuple[int, int], is_there: Callable[[bytes], bool]) -> Any:
        """Return an agent's description, as new as wanted, if one publisher alone speaks for it; or None."""
        speakers = [publisher for publisher, said in self._last.items() if said.agent == agent]
        if len(speakers) > 1:
            speakers = [publisher for publisher in speakers if is_there(publisher)]
        if len(speakers) != 1:
            return None
        said = self._last[speakers[0]]
        return said if (said.incarnation, said.revision) >= wanted else None
