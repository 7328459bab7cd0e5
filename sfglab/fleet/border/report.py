"""What the linter says: findings, who hears what, and the loads to be expected, as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sfglab.documents import Place
    from sfglab.names import ResourceKind


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
    """One thing that is wrong or worth knowing."""

    severity: Severity  #: How bad it is.
    code: str  #: Its kind, a short stable name.
    place: Place  #: Where it stands.
    what: str  #: What was found.
    why: str  #: What follows from it, and by which rule.
    remedy: str = ""  #: What to do; empty where there is nothing to do.


@dataclass(frozen=True, slots=True, kw_only=True)
class Hearing:
    """Who hears whom under one name."""

    name: str  #: ROS name.
    kind: ResourceKind  #: Topic, service or action.
    speakers: tuple[str, ...]  #: Agents that publish or serve it.
    hearers: tuple[str, ...]  #: Agents that subscribe or call it.
    crosses: bool  #: Whether it gets from one agent to another.
    rules: tuple[str, ...]  #: Patterns of the rules that let it cross.


@dataclass(frozen=True, slots=True, kw_only=True)
class Announcements:
    """What discovery has to say between hosts, for the whole fleet."""

    participants: int  #: Participants in the domain that hosts share.
    endpoints: int  #: Endpoints in it.
    pairs: int  #: Ordered pairs of participants on different hosts: each tells the other about itself.
    announced: int  #: Announcements of an endpoint to a participant on another host.
    estimated_bytes: int  #: What hosts receive for both, together.


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovery:
    """Discovery with one domain for all, and through routers."""

    standard: Announcements  #: Every process of every agent in one domain.
    routed: Announcements  #: Only the routers meet, and show what is wanted across.
    local: dict[str, tuple[int, int]]  #: Participants and endpoints in each agent's own domain, by agent.
    shown: dict[str, int]  #: Endpoints that each agent's router shows in the global domain, by agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentLoad:
    """What crosses one agent's border once everything runs; messages and bytes a second."""

    agent: str  #: The agent.
    tf_out_hz: float = 0.0  #: Transform messages that leave it.
    tf_in_hz: float = 0.0  #: Transform messages that it receives from all others.
    tf_out_bps: float = 0.0  #: Bits a second of them, leaving.
    tf_in_bps: float = 0.0  #: Bits a second of them, entering.
    topics_out_bps: float = 0.0  #: Bits a second of other topics that somebody else subscribes.
    topics_in_bps: float = 0.0  #: Bits a second of other topics that it subscribes from others.
    unsized: tuple[str, ...] = ()  #: Crossing topics without rate or size, which are not in the sums.


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Everything the linter has to say about a fleet."""

    fleet: str  #: Name of the fleet.
    findings: tuple[Finding, ...]  #: The worst first, then in the order of the file.
    hearings: tuple[Hearing, ...]  #: Who hears what, by name.
    discovery: Discovery  #: What discovery will cost.
    loads: tuple[AgentLoad, ...]  #: What crosses each border.

    def count(self, severity: Severity) -> int:
        """Return how many findings are of a severity."""
        return sum(f.severity is severity for f in self.findings)

    @property
    def exit_code(self) -> int:
        """1 if there is an error, else 0."""
        return 1 if self.count(Severity.ERROR) else 0
