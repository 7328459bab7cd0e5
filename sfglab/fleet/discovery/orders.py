"""What a registry of remote agents is told, what it wants done, and what can be seen of it, as values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.fleet.discovery.lifecycle import Action, Input, State


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
    """How long a discoverer waits for what."""

    missed: float = 3.0  #: An agent is lost when this many of its announced periods pass without a heartbeat.
    slack_ns: int = 500_000_000  #: Time on top of that, for the network.
    backoff_ns: int = 250_000_000  #: Wait after the first failed query; it doubles with each further one.
    backoff_max_ns: int = 10_000_000_000  #: The longest wait between queries.
    forget_ns: int = 600_000_000_000  #: How long a lost agent is remembered.

    def __post_init__(self) -> None:
        for name in ("missed", "slack_ns", "backoff_ns", "backoff_max_ns", "forget_ns"):
            if not getattr(self, name) > 0:
                raise TimingError(name, getattr(self, name))


@dataclass(frozen=True, slots=True, kw_only=True)
class Ask:
    """Ask an agent for its metadata, and say `answered` or `failed` with the same query."""

    agent: str  #: Whom.
    query: int  #: Which query it is; no two are the same.


@dataclass(frozen=True, slots=True, kw_only=True)
class Abandon:
    """Give up a query."""

    agent: str  #: Who was asked.
    query: int  #: Which query.


@dataclass(frozen=True, slots=True, kw_only=True)
class Announce:
    """Tell local consumers."""

    agent: str  #: Of whom.
    event: str  #: The event, by the name of a constant of ``AgentDiscoveryEvent``.
    incarnation: int  #: Which start of the agent the description is from.
    metadata: Any  #: Its last known description.


Order = Ask | Abandon | Announce


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What an agent answered."""

    agent: str  #: Whose description it claims to be.
    incarnation: int  #: Which start of it.
    revision: int  #: Which revision.
    metadata: Any  #: The description.


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """A transition that was taken."""

    agent: str  #: Whose.
    before: State  #: State before.
    given: Input  #: Input.
    after: State  #: State after.
    actions: tuple[Action, ...]  #: What was done.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentStatus:
    """One remote agent as the registry sees it."""

    agent: str  #: Its name.
    state: State  #: Where it stands.
    incarnation: int  #: Which start of it was heard last.
    revision: int  #: Which revision of its description was heard last.
    failures: int  #: Queries that failed since the last one that did not.
    heard_ns: int  #: When it was heard last, on the caller's clock.
