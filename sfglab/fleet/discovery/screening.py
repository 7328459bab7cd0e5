"""Screening of heartbeats: the domain is shared, and anybody can publish anything there.

Pure: knows rates, bounds and the naming schema; refuses to know which agents there are.
"""

from __future__ import annotations

import functools
import math
from collections import OrderedDict
from dataclasses import dataclass
from enum import Enum

from sfglab.errors import InvalidValueError
from sfglab.fleet.status.heartbeat import MAX_PERIOD_S, MIN_PERIOD_S, Heartbeat, Phase, metadata_service
from sfglab.names import FqnError

_MAX_NAME_LENGTH = 255
_MAX_VERSION_LENGTH = 128
_PHASES = frozenset(int(phase) for phase in Phase)


class Refusal(Enum):
    """Why a heartbeat does not count."""

    MALFORMED = "malformed"  #: It is no heartbeat: bytes, name, phase, period or version are not allowed.
    FLOOD = "flood"  #: There are more than a fleet would send.
    OWN = "own"  #: It is the discoverer's own agent's.
    SPOOFED = "spoofed"  #: It bears the discoverer's own agent's name and comes from somebody else.
    STALE = "stale"  #: It is from a start of the agent before the one that is there.
    FULL = "full"  #: It is from an agent for which there is no place.


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much a discoverer takes in. A fleet in start-up sends one heartbeat a second and agent."""

    #: Remote agents that are kept track of, at most 900: consumers that come late hear of each.
    max_agents: int = 500
    beats_per_s: float = 25.0  #: Heartbeats per second that one publisher may send for long.
    burst: int = 50  #: Heartbeats that one publisher may send at once.
    total_per_s: float = 1000.0  #: The same for all publishers together.
    total_burst: int = 5000  #: The same for all publishers together.
    max_metadata_bytes: int = 65_536  #: Longest description, serialized.

    def __post_init__(self) -> None:
        if not 1 <= self.max_agents <= 900:
            raise InvalidValueError("discovery, max_agents", self.max_agents, "whole numbers from 1 to 900")
        for name in ("beats_per_s", "burst", "total_per_s", "total_burst", "max_metadata_bytes"):
            given = getattr(self, name)
            if not 0 < given < math.inf:
                raise InvalidValueError(f"discovery, {name}", given, "positive numbers")


class _Bucket:
    """A token bucket: `rate_per_s` for long, `burst` at once."""

    __slots__ = ("_burst", "_rate_per_ns", "_tokens", "_updated_ns")

    def __init__(self, rate_per_s: float, burst: int, now_ns: int) -> None:
        self._rate_per_ns = rate_per_s / 1e9
        self._burst = float(burst)
        self._tokens = float(burst)
        self._updated_ns = now_ns

    def take(self, now_ns: int) -> bool:
        gained = max(0, now_ns - self._updated_ns) * self._rate_per_ns
        self._tokens = min(self._burst, self._tokens + gained)
        self._updated_ns = max(now_ns, self._updated_ns)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True


class Screen:
    """The checks by a discoverer's agent that need nothing but the heartbeat, who published it, and when."""

    def __init__(self, agent: str, limits: Limits) -> None:
        self._agent = agent
        self._limits = limits
        self._total = _Bucket(limits.total_per_s, limits.total_burst, 0)
        self._buckets: OrderedDict[bytes, _Bucket] = OrderedDict()
        self._own: tuple[int, bytes] | None = None  # its last incarnation and publisher

    def check(self, heartbeat: Heartbeat, publisher_gid: bytes, *, now_ns: int) -> Refusal | None:
        """Return why a heartbeat of a publisher does not count, or None if it does."""
        # One publisher's flood must not take the others' share, so its own bucket comes first.
        if not (self._bucket(publisher_gid, now_ns).take(now_ns) and self._total.take(now_ns)):
            return Refusal.FLOOD
        if not _well_formed(heartbeat):
            return Refusal.MALFORMED
        if heartbeat.agent == self._agent:
            return self._check_own(heartbeat, publisher_gid)
        return None

    def _bucket(self, publisher_gid: bytes, now_ns: int) -> _Bucket:
        bucket = self._buckets.get(publisher_gid)
        if bucket is None:
            bucket = _Bucket(self._limits.beats_per_s, self._limits.burst, now_ns)
            self._buckets[publisher_gid] = bucket
            if len(self._buckets) > 2 * self._limits.max_agents:
                self._buckets.popitem(last=False)
        self._buckets.move_to_end(publisher_gid)
        return bucket

    def _check_own(self, heartbeat: Heartbeat, publisher_gid: bytes) -> Refusal:
        """Tell our own agent from another one that bears its name: the latest to start is taken for ours.

        With two of them alive, the older one's heartbeats are counted as spoofed, for as long as it lives.
        """
        if self._own is None or heartbeat.incarnation > self._own[0]:
            self._own = heartbeat.incarnation, publisher_gid
        return Refusal.OWN if publisher_gid == self._own[1] else Refusal.SPOOFED


def _well_formed(heartbeat: Heartbeat) -> bool:
    return (
        len(heartbeat.agent) <= _MAX_NAME_LENGTH
        and _can_be_asked(heartbeat.agent)
        and heartbeat.phase in _PHASES
        and MIN_PERIOD_S <= heartbeat.period_s <= MAX_PERIOD_S
        and len(heartbeat.version) <= _MAX_VERSION_LENGTH
    )


@functools.lru_cache(maxsize=1024)
def _can_be_asked(agent: str) -> bool:
    """Return whether the schema has a name for this agent's metadata service; every heartbeat asks."""
    try:
        metadata_service(agent)
    except FqnError:
        return False
    return True
