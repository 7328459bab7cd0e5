"""What a registry of remote agents is told, what it wants done, and what can be seen of it, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.fleet.discovery.lifecycle import Action, Input, State

__all__ = ["Abandon", "AgentStatus", "Announce", "Answer", "Ask", "Move", "Order", "Timing", "TimingError"]


class TimingError(SfglabError, ValueError):
    """Waits with which a discoverer could not work.

    Attributes:
        name: The field in question.
        given: Its value.
    """

    def __init__(self, name: str, given: float) -> None:
        self.name = name
        self.given = given
        super().__init__(f"discovery, {name}: given {given}, allowed are positive numbers")


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long a discoverer waits for what.

    Attributes:
        missed: An agent is lost when this many of its announced periods pass without a heartbeat.
        slack_ns: Time on top of that, for the network.
        backoff_ns: Wait after the first failed query; it doubles with each further one.
        backoff_max_ns: The longest wait between queries.
        forget_ns: How long a lost agent is remembered.
    """

    missed: float = 3.0
    slack_ns: int = 500_000_000
    backoff_ns: int = 250_000_000
    backoff_max_ns: int = 10_000_000_000
    forget_ns: int = 600_000_000_000

    def __post_init__(self) -> None:
        for name in ("missed", "slack_ns", "backoff_ns", "backoff_max_ns", "forget_ns"):
            if not getattr(self, name) > 0:
                raise TimingError(name, getattr(self, name))


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """Ask an agent for its metadata, and say `answered` or `failed` with the same query.

    Attributes:
        agent: Whom.
        query: Which query it is; no two are the same.
    """

    agent: str
    query: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Abandon:
    """Give up a query.

    Attributes:
        agent: Who was asked.
        query: Which query.
    """

    agent: str
    query: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Announce:
    """Tell local consumers.

    Attributes:
        agent: Of whom.
        event: The event, by the name of a constant of ``AgentDiscoveryEvent``.
        incarnation: Which start of the agent the description is from.
        metadata: Its last known description.
    """

    agent: str
    event: str
    incarnation: int
    metadata: Any


Order = Ask | Abandon | Announce


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What an agent answered.

    Attributes:
        agent: Whose description it claims to be.
        incarnation: Which start of it.
        revision: Which revision.
        metadata: The description.
    """

    agent: str
    incarnation: int
    revision: int
    metadata: Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """A transition that was taken.

    Attributes:
        agent: Whose.
        before: State before.
        given: Input.
        after: State after.
        actions: What was done.
    """

    agent: str
    before: State
    given: Input
    after: State
    actions: tuple[Action, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentStatus:
    """One remote agent as the registry sees it.

    Attributes:
        agent: Its name.
        state: Where it stands.
        incarnation: Which start of it was heard last.
        revision: Which revision of its description was heard last.
        failures: Queries that failed since the last one that did not.
        heard_ns: When it was heard last, on the caller's clock.
    """

    agent: str
    state: State
    incarnation: int
    revision: int
    failures: int
    heard_ns: int
