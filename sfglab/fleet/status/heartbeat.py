"""The heartbeat as a value, and the names on the wire that belong to an agent's status.

Knows the interfaces and the naming schema; refuses to know when a heartbeat is sent and whether one that was
heard can be believed.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import Resource, RosFqnBuilder, Scope

AGENT_HEARTBEAT = "sfglab_interfaces/msg/AgentHeartbeat"
AGENT_METADATA = "sfglab_interfaces/msg/AgentMetadata"
GET_METADATA = "sfglab_interfaces/srv/GetMetadata"


def heartbeat_topic() -> str:
    """Return ``/global/agent_heartbeat``, the topic of all agents' heartbeats: paper A, section 4.2."""
    return str(RosFqnBuilder().scope(Scope.GLOBAL).without_agent().resource(Resource.AGENT_HEARTBEAT).build())


def metadata_service(agent: str) -> str:
    """Return ``/global/<agent>/get_metadata``, where an agent is asked what it is: paper A, section 4.2.

    Raises:
        FqnError: No agent can bear this name.
    """
    return str(RosFqnBuilder().scope(Scope.GLOBAL).agent(agent).resource(Resource.GET_METADATA).build())


class Phase(IntEnum):
    """Where an agent is in its life, by the numbers of ``AgentHeartbeat``."""

    STARTUP = 0
    """It has just started: others may not know it yet."""
    STEADY = 1
    """It has been running for a while."""


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
        return message_type(AGENT_HEARTBEAT)(
            stamp=stamp_from_ns(stamp_ns),
            agent=self.agent,
            incarnation=self.incarnation,
            revision=self.revision,
            phase=int(self.phase),
            period_s=self.period_s,
            version=self.version,
        )

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
