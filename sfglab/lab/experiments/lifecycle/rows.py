"""The rows that the life-cycle experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AnswerRow", "BeatRow", "CountRow", "FaultRow", "JoinRow", "MoveRow", "QueryRow", "WireEndpointRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BeatRow:
    """A heartbeat as a listener on another host heard it.

    Attributes:
        listener: ``first``, or ``late`` for the one that joined in the steady state.
        agent: Who sent it.
        incarnation: Which start of the agent.
        revision: Which revision of its description.
        phase: 0 start-up, 1 steady.
        period_s: The time that it announces until the next one, seconds.
        sent_ns: When it was published, nanoseconds since the epoch.
        received_ns: When the listener took it.
        gid: The publisher's GUID, hexadecimal.
    """

    listener: str
    agent: str
    incarnation: int
    revision: int
    phase: int
    period_s: float
    sent_ns: int
    received_ns: int
    gid: str


@dataclass(frozen=True, slots=True, kw_only=True)
class JoinRow:
    """A listener that joined the domain.

    Attributes:
        listener: Which one.
        t_ns: When it made its subscription, nanoseconds since the epoch.
    """

    listener: str
    t_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class WireEndpointRow:
    """A publisher of heartbeats as the listener's graph showed it.

    Attributes:
        topic: ROS topic.
        type: ROS type.
        reliability: What is offered.
        durability: What is offered.
        gid: Its GUID, hexadecimal.
    """

    topic: str
    type: str
    reliability: str
    durability: str
    gid: str


@dataclass(frozen=True, slots=True, kw_only=True)
class AnswerRow:
    """A call of an agent's metadata service from another host.

    Attributes:
        agent: Who was asked.
        service: Under which name.
        answered: Whether an answer came.
        incarnation: Which start of the agent it describes.
        took_s: From the call to the answer, finding the service included, seconds.
    """

    agent: str
    service: str
    answered: bool
    incarnation: int
    took_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveRow:
    """A transition that a discoverer took.

    Attributes:
        discoverer: The agent that it belongs to.
        agent: The remote agent.
        before: State before.
        given: Input.
        after: State after.
        actions: What was done, joined by ``;``.
        t_ns: When, nanoseconds since the epoch.
    """

    discoverer: str
    agent: str
    before: str
    given: str
    after: str
    actions: str
    t_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class QueryRow:
    """A query that arrived at a false agent.

    Attributes:
        agent: Who was asked.
        t_ns: When it arrived, nanoseconds since the epoch.
    """

    agent: str
    t_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRow:
    """Something that was done to provoke a transition.

    Attributes:
        agent: To whom.
        what: What was done.
        t_ns: When, nanoseconds since the epoch.
    """

    agent: str
    what: str
    t_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CountRow:
    """One of a discoverer's counters at the end.

    Attributes:
        discoverer: The agent that it belongs to.
        name: The counter.
        count: Its value.
    """

    discoverer: str
    name: str
    count: int
