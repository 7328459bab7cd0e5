"""Heartbeats: their names on the wire, as values, and their schedule. Paper A, section 4.2: 1 s and 5 s."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any

from sfglab.errors import InvalidValueError
from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import Resource, RosFqnBuilder, Scope, Suffixed

AGENT_HEARTBEAT = "sfglab_interfaces/msg/AgentHeartbeat"
AGENT_METADATA = "sfglab_interfaces/msg/AgentMetadata"
GET_METADATA = "sfglab_interfaces/srv/GetMetadata"


def heartbeat_topic() -> str:
    """Return ``/global/agent_heartbeat``, the topic of all agents' heartbeats: paper A, section 4.2."""
    return str(
        RosFqnBuilder()
        .scope(Scope.GLOBAL)
        .without_agent()
        .resource(Resource.AGENT_HEARTBEAT)
        .build()
    )


def metadata_topic() -> str:
    """Return ``/global/agent_heartbeat_metadata``, on which agents offer what they are, without being asked."""
    resource = Suffixed(base=Resource.AGENT_HEARTBEAT, suffix="metadata")
    return str(RosFqnBuilder().scope(Scope.GLOBAL).without_agent().resource(resource).build())


def metadata_service(agent: str) -> str:
    """Return ``/global/<agent>/get_metadata``, where an agent is asked what it is: paper A, section 4.2.

    Raises:
        FqnError: No agent can bear this name.
    """
    return str(
        RosFqnBuilder().scope(Scope.GLOBAL).agent(agent).resource(Resource.GET_METADATA).build()
    )


class Phase(IntEnum):
    """Where an agent is in its life, by the numbers of ``AgentHeartbeat``."""

    STARTUP = 0  #: It has just started: others may not know it yet.
    STEADY = 1  #: It has been running for a while.


@dataclass(frozen=True, slots=True, kw_only=True)
class Heartbeat:
    """A heartbeat, as it was sent or heard; what was heard may hold anything."""

    agent: str  #: Who sends it.
    incarnation: int  #: When that agent started, nanoseconds on its clock.
    revision: int  #: How often its description has changed since then.
    phase: int  #: A `Phase` as a number.
    period_s: float  #: Time until its next heartbeat, seconds.
    version: str  #: Version of its software.

    def to_message(self, stamp_ns: int) -> Any:
        """Return the ``AgentHeartbeat`` that is sent at `stamp_ns`, nanoseconds since the epoch."""
        values = asdict(self) | {"phase": int(self.phase)}
        return message_type(AGENT_HEARTBEAT)(stamp=stamp_from_ns(stamp_ns), **values)

    @classmethod
    def from_message(cls, message: Any) -> Heartbeat:
        """Return what an ``AgentHeartbeat`` says."""
        return cls(
            agent=message.agent,
            incarnation=int(message.incarnation),
            revision=int(message.revision),
            phase=int(message.phase),
            period_s=float(message.period_s),
            version=message.version,
        )


MIN_PERIOD_S = 0.05  #: The shortest period that is believed; below it, heartbeats would be traffic.

#: The longest that is believed; above it a lost agent would be missed too late.
MAX_PERIOD_S = 60.0

#: Largest message of a process that only hears of agents and what they are.
MAX_SAMPLE_BYTES = 1 << 20

_MAX_STARTUP_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """The instants of an agent's heartbeats, the first at its start; the start-up phase lasts whole periods."""

    startup_period_s: float = 1.0  #: Period in the start-up phase, seconds.
    steady_period_s: float = 5.0  #: Period afterwards, seconds.
    startup_s: float = 10.0  #: How long the start-up phase lasts, seconds; 0: there is none.

    def __post_init__(self) -> None:
        periods = (MIN_PERIOD_S, MAX_PERIOD_S)
        ranges = {
            "startup_period_s": periods,
            "steady_period_s": periods,
            "startup_s": (0, _MAX_STARTUP_S),
        }
        for name, (low, high) in ranges.items():
            if not low <= (given := getattr(self, name)) <= high:
                raise InvalidValueError(
                    f"heartbeat schedule, {name}", given, f"seconds from {low} to {high}"
                )

    def phase(self, elapsed_ns: int) -> Phase:
        """Return the phase at a time since the start, nanoseconds."""
        return Phase.STARTUP if elapsed_ns < self._steady_from_ns else Phase.STEADY

    def next_ns(self, elapsed_ns: int) -> int:
        """Return the next instant, ns since the start; what was missed is not made up for."""
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
