"""What the linter says: findings, who hears what, and the loads to be expected, as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sfglab.documents import Place
    from sfglab.names import ResourceKind

__all__ = ["AgentLoad", "Announcements", "Discovery", "Finding", "Hearing", "Report", "Severity"]


class Severity(Enum):
    """How bad a finding is, the worst first."""

    ERROR = "error"
    """Something that the fleet relies on will not work."""
    WARNING = "warning"
    """It works, but probably not as meant, or not for long."""
    INFO = "info"
    """Worth knowing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that is wrong or worth knowing.

    Attributes:
        severity: How bad it is.
        code: Its kind, a short stable name.
        place: Where it stands.
        what: What was found.
        why: What follows from it, and by which rule.
        remedy: What to do; empty where there is nothing to do.
    """

    severity: Severity
    code: str
    place: Place
    what: str
    why: str
    remedy: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hearing:
    """Who hears whom under one name.

    Attributes:
        name: ROS name.
        kind: Topic, service or action.
        speakers: Agents that publish or serve it.
        hearers: Agents that subscribe or call it.
        crosses: Whether it gets from one agent to another.
        rules: Patterns of the rules that let it cross.
    """

    name: str
    kind: ResourceKind
    speakers: tuple[str, ...]
    hearers: tuple[str, ...]
    crosses: bool
    rules: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Announcements:
    """What discovery has to say between hosts, for the whole fleet.

    Attributes:
        participants: Participants in the domain that hosts share.
        endpoints: Endpoints in it.
        pairs: Ordered pairs of participants on different hosts: each tells the other about itself.
        announced: Announcements of an endpoint to a participant on another host.
        estimated_bytes: What hosts receive for both, together.
    """

    participants: int
    endpoints: int
    pairs: int
    announced: int
    estimated_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovery:
    """Discovery with one domain for all, and through routers.

    Attributes:
        standard: Every process of every agent in one domain.
        routed: Only the routers meet, and show what is wanted across.
        local: Participants and endpoints in each agent's own domain, by agent.
        shown: Endpoints that each agent's router shows in the global domain, by agent.
    """

    standard: Announcements
    routed: Announcements
    local: dict[str, tuple[int, int]]
    shown: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentLoad:
    """What crosses one agent's border once everything runs; messages and bytes a second.

    Attributes:
        agent: The agent.
        tf_out_hz: Transform messages that leave it.
        tf_in_hz: Transform messages that it receives from all others.
        tf_out_bps: Bits a second of them, leaving.
        tf_in_bps: Bits a second of them, entering.
        topics_out_bps: Bits a second of other topics that somebody else subscribes.
        topics_in_bps: Bits a second of other topics that it subscribes from others.
        unsized: Crossing topics without rate or size, which are not in the sums.
    """

    agent: str
    tf_out_hz: float = 0.0
    tf_in_hz: float = 0.0
    tf_out_bps: float = 0.0
    tf_in_bps: float = 0.0
    topics_out_bps: float = 0.0
    topics_in_bps: float = 0.0
    unsized: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Everything the linter has to say about a fleet.

    Attributes:
        fleet: Name of the fleet.
        findings: The worst first, then in the order of the file.
        hearings: Who hears what, by name.
        discovery: What discovery will cost.
        loads: What crosses each border.
    """

    fleet: str
    findings: tuple[Finding, ...]
    hearings: tuple[Hearing, ...]
    discovery: Discovery
    loads: tuple[AgentLoad, ...]

    def count(self, severity: Severity) -> int:
        """Return how many findings are of a severity."""
        return sum(f.severity is severity for f in self.findings)

    @property
    def exit_code(self) -> int:
        """1 if there is an error, else 0."""
        return 1 if self.count(Severity.ERROR) else 0
