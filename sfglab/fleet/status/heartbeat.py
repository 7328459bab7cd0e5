"""Heartbeats: topic and service names, values, and schedule. Paper A, section 4.2: periods of 1 s and 5 s."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any

from sfglab.fields import between, check_bounds
from sfglab.names import Resource, RosFqnBuilder, Scope, Suffixed

AGENT_HEARTBEAT = "sfglab_interfaces/msg/AgentHeartbeat"
AGENT_METADATA = "sfglab_interfaces/msg/AgentMetadata"
GET_METADATA = "sfglab_interfaces/srv/GetMetadata"


def heartbeat_topic() -> str:
    """Return ``/global/agent_heartbeat``, the topic of all agents' heartbeats: paper A, section 4.2."""
    return _shared_topic(Resource.AGENT_HEARTBEAT)


def metadata_topic() -> str:
    """Return ``/global/agent_heartbeat_metadata``, the topic of all agents' published descriptions."""
    return _shared_topic(Suffixed(base=Resource.AGENT_HEARTBEAT, suffix="metadata"))


def _shared_topic(resource: Resource | Suffixed[Resource]) -> str:
    return str(RosFqnBuilder().scope(Scope.GLOBAL).without_agent().resource(resource).build())


def metadata_service(agent: str) -> str:
    """Return ``/global/<agent>/get_metadata``, the metadata service of an agent: paper A, section 4.2.

    Raises:
        FqnError: The name is invalid for an agent.
    """
    return str(
        RosFqnBuilder().scope(Scope.GLOBAL).agent(agent).resource(Resource.GET_METADATA).build()
    )


class Phase(IntEnum):
    """Phase of an agent, with the numbers of ``AgentHeartbeat``."""

    STARTUP = 0  #: The agent has just started; others may not have discovered it.
    STEADY = 1  #: The agent has been running for a while.


@dataclass(frozen=True, slots=True, kw_only=True)
class Heartbeat:
    """Heartbeat of an agent. The values of a received heartbeat are not validated."""

    agent: str  #: Name of the agent.
    incarnation: int  #: Start time of the agent, nanoseconds on its clock.
    revision: int  #: Number of changes of its description since the start.
    phase: int  #: `Phase` as a number.
    period_s: float  #: Time until the next heartbeat, seconds.
    version: str  #: Version of the agent's software.

    def to_message(self, stamp_ns: int) -> Any:
        """Return the ``AgentHeartbeat`` with a time stamp in nanoseconds since the epoch."""
        from sfglab.messages import message_type, stamp_from_ns

        values = asdict(self) | {"phase": int(self.phase)}
        return message_type(AGENT_HEARTBEAT)(stamp=stamp_from_ns(stamp_ns), **values)

    @classmethod
    def from_message(cls, message: Any) -> Heartbeat:
        """Return the values of an ``AgentHeartbeat``."""
        return cls(
            agent=message.agent,
            incarnation=int(message.incarnation),
            revision=int(message.revision),
            phase=int(message.phase),
            period_s=float(message.period_s),
            version=message.version,
        )


MIN_PERIOD_S = 0.05  #: Shortest valid period; shorter ones would load the network.

#: Longest valid period; with longer ones the loss of an agent would be detected too late.
MAX_PERIOD_S = 60.0

#: Largest message that a status provider or a discoverer receives.
MAX_SAMPLE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """Times of an agent's heartbeats, the first at its start. The startup phase lasts whole periods."""

    #: Period in the startup phase, seconds.
    startup_period_s: float = between(1.0, MIN_PERIOD_S, MAX_PERIOD_S)
    steady_period_s: float = between(
        5.0, MIN_PERIOD_S, MAX_PERIOD_S
    )  #: Period afterwards, seconds.
    startup_s: float = between(
        10.0, 0, 3600
    )  #: Duration of the startup phase, seconds; 0: there is none.

    def __post_init__(self) -> None:
        check_bounds(self, "heartbeat schedule, ")

    def phase(self, elapsed_ns: int) -> Phase:
        """Return the phase at a time since the start, nanoseconds."""
        return Phase.STARTUP if elapsed_ns < self._steady_from_ns else Phase.STEADY

    def next_ns(self, elapsed_ns: int) -> int:
        """Return the time of the next heartbeat, ns since the start. Missed heartbeats are skipped."""
        if elapsed_ns < self._steady_from_ns:
            return (elapsed_ns // self._startup_ns + 1) * self._startup_ns
        since_ns = elapsed_ns - self._steady_from_ns
        steady_ns = round(self.steady_period_s * 1e9)
        return self._steady_from_ns + (since_ns // steady_ns + 1) * steady_ns

    @property
    def _startup_ns(self) -> int:
        return round(self.startup_period_s * 1e9)

    @property
    def _steady_from_ns(self) -> int:
        return math.ceil(round(self.startup_s * 1e9) / self._startup_ns) * self._startup_ns
