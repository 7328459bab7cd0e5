"""The rows that the life-cycle experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class BeatRow:
    """A heartbeat as a listener on another host heard it."""

    listener: str  #: ``first``, or ``late`` for the one that joined in the steady state.
    agent: str  #: Who sent it.
    incarnation: int  #: Which start of the agent.
    revision: int  #: Which revision of its description.
    phase: int  #: 0 start-up, 1 steady.
    period_s: float  #: The time that it announces until the next one, seconds.
    sent_ns: int  #: When it was published, nanoseconds since the epoch.
    received_ns: int  #: When the listener took it.
    gid: str  #: The publisher's GUID, hexadecimal.


@dataclass(frozen=True, slots=True, kw_only=True)
class JoinRow:
    """A listener that joined the domain."""

    listener: str  #: Which one.
    t_ns: int  #: When it made its subscription, nanoseconds since the epoch.


@dataclass(frozen=True, slots=True, kw_only=True)
class WireEndpointRow:
    """A publisher of heartbeats as the listener's graph showed it."""

    topic: str  #: ROS topic.
    type: str  #: ROS type.
    reliability: str  #: What is offered.
    durability: str  #: What is offered.
    gid: str  #: Its GUID, hexadecimal.


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerRow:
    """A call of an agent's metadata service from another host."""

    agent: str  #: Who was asked.
    service: str  #: Under which name.
    answered: bool  #: Whether an answer came.
    incarnation: int  #: Which start of the agent it describes.
    took_s: float  #: From the call to the answer, finding the service included, seconds.


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveRow:
    """A transition that a discoverer took."""

    discoverer: str  #: The agent that it belongs to.
    agent: str  #: The remote agent.
    before: str  #: State before.
    given: str  #: Input.
    after: str  #: State after.
    actions: str  #: What was done, joined by ``;``.
    t_ns: int  #: When, nanoseconds since the epoch.


@dataclass(frozen=True, slots=True, kw_only=True)
class QueryRow:
    """A query that arrived at a false agent."""

    agent: str  #: Who was asked.
    t_ns: int  #: When it arrived, nanoseconds since the epoch.


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRow:
    """Something that was done to provoke a transition."""

    agent: str  #: To whom.
    what: str  #: What was done.
    t_ns: int  #: When, nanoseconds since the epoch.


@dataclass(frozen=True, slots=True, kw_only=True)
class CountRow:
    """One of a discoverer's counters at the end."""

    discoverer: str  #: The agent that it belongs to.
    name: str  #: The counter.
    count: int  #: Its value.
