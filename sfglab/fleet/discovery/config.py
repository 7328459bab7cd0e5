"""Configuration of an agent discoverer. The module imports no nodes, so that it loads fast."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.bus.address import BusAddress
from sfglab.fields import between, check_bounds
from sfglab.names import validate_agent

MAX_AGENTS = 500


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Timeouts and waits of a discoverer."""

    #: Announced periods without a heartbeat after which an agent is lost.
    missed: float = between(3.0, without=(0,))
    slack_ns: int = between(500_000_000, without=(0,))  #: Additional time for the network, ns.
    #: Wait after the first failed query, ns; each further failure doubles it.
    backoff_ns: int = between(250_000_000, without=(0,))
    #: Longest wait between queries, ns.
    backoff_max_ns: int = between(10_000_000_000, without=(0,))
    #: Time until a lost agent is forgotten, ns.
    forget_ns: int = between(600_000_000_000, without=(0,))

    def __post_init__(self) -> None:
        check_bounds(self, "discovery, ")


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoverySettings:
    """Settings of a discoverer."""

    agent: str  #: Name of the discoverer's own agent, whose heartbeats it ignores.
    timing: Timing = field(default_factory=Timing)  #: Timeouts and waits.
    #: Largest number of remote agents in the table: at most 900, so that a late joiner receives an event of each.
    max_agents: int = between(MAX_AGENTS, 1, 900)
    #: Timeout for the answer of a metadata service, seconds.
    query_timeout_s: float = between(2.0, 0, 60, without=(0,))
    #: Whether descriptions that agents publish are used. If false, and for agents that publish none, the
    #: paper's metadata service is called.
    use_published_descriptions: bool = True
    #: Maximum number of service calls at once. Agents without a failed query go first.
    max_queries: int = between(128, 1)

    def __post_init__(self) -> None:
        validate_agent(self.agent)
        check_bounds(self, "discovery, ")


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoveryConfig:
    """Configuration of a discoverer's process."""

    address: BusAddress  #: The agent's local domain.
    settings: DiscoverySettings  #: Settings of the discoverer.
    report_moves: bool = False  #: Whether each transition is reported.
