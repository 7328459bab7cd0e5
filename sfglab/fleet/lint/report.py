"""Report of the schema lint: findings, who hears what, and the loads to be expected, as values and as text."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING

from sfglab.tables import WIDTH, text_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.documents import Place
    from sfglab.names import ResourceKind


class Severity(Enum):
    """How bad a finding is, the worst first."""

    ERROR = "error"  #: Something that the fleet relies on will not work.
    WARNING = "warning"  #: It works, but probably not as meant, or not for long.
    INFO = "info"  #: Worth knowing.


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that is wrong or worth knowing."""

    severity: Severity  #: How bad it is.
    code: str  #: Its kind, a short stable name.
    place: Place  #: Where it stands.
    what: str  #: What was found.
    why: str  #: What follows from it, and by which rule.
    remedy: str = ""  #: What to do; empty where there is nothing to do.


# How a check makes one.
an_error = partial(Finding, severity=Severity.ERROR)
a_warning = partial(Finding, severity=Severity.WARNING)
a_remark = partial(Finding, severity=Severity.INFO)


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
    #: Ordered pairs of participants on different hosts: each tells the other about itself.
    pairs: int
    announced: int  #: Announcements of an endpoint to a participant on another host.
    estimated_bytes: int  #: What hosts receive for both, together.


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovery:
    """Discovery with one domain for all, and through routers."""

    standard: Announcements  #: Every process of every agent in one domain.
    routed: Announcements  #: Only the routers meet, and show what is wanted across.
    #: Participants and endpoints in each agent's own domain, by agent.
    local: dict[str, tuple[int, int]]
    #: Endpoints that each agent's router shows in the global domain, by agent.
    shown: dict[str, int]


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
    #: Crossing topics without rate or size, which are not in the sums.
    unsized: tuple[str, ...] = ()


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


def render(report: Report) -> str:
    """Return a report as text: findings, who hears what, discovery, and what crosses each border."""
    counts = ", ".join(
        f"{report.count(s)} {s.value}{'' if report.count(s) == 1 else 's'}" for s in Severity
    )
    blocks = [
        f"fleet {report.fleet}",
        render_findings(report.findings),
        "who hears what\n" + text_table(_hearings(report)),
        "discovery between hosts, estimated\n" + text_table(_discovery(report.discovery)),
        "across each border, estimated\n" + text_table(_loads(report.loads)),
        f"{report.fleet}: {counts}".replace("infos", "info"),
    ]
    return "\n\n".join(blocks) + "\n"


def render_findings(findings: Iterable[Finding]) -> str:
    """Return findings as text, one paragraph each."""
    return "\n".join(_finding(finding) for finding in findings) or "no findings"


def _finding(finding: Finding) -> str:
    head = f"{finding.severity.value}: {finding.place}: {finding.what} [{finding.code}]"
    lines = [head, *_wrapped("why: ", finding.why)]
    return "\n".join(lines + (_wrapped("remedy: ", finding.remedy) if finding.remedy else []))


def _wrapped(label: str, text: str) -> list[str]:
    return textwrap.wrap(
        text, WIDTH, initial_indent=f"    {label}", subsequent_indent=" " * (4 + len(label))
    )


def _hearings(report: Report) -> Iterator[tuple[str, ...]]:
    everybody = tuple(load.agent for load in report.loads)
    yield "name", "kind", "from", "to", "by rule"
    for row in report.hearings:
        rules = ", ".join(row.rules) if row.crosses else "does not cross"
        speakers, hearers = _crowd(row.speakers, everybody), _crowd(row.hearers, everybody)
        others = tuple(name for name in everybody if name not in row.speakers)
        hearers = "all others" if set(row.hearers) == set(others) else hearers
        yield row.name, row.kind.value, speakers, hearers, rules


def _crowd(names: Sequence[str], everybody: Sequence[str]) -> str:
    return "all" if set(names) == set(everybody) else _listed(names)


def _discovery(found: Discovery) -> Iterator[tuple[str, ...]]:
    yield (
        "",
        "participants",
        "endpoints",
        "pairs of participants",
        "announcements",
        "bytes",
        "grows with",
    )
    yield _announcements("one domain for all", found.standard, "(processes in the fleet)^2")
    yield _announcements("through routers", found.routed, "agents^2, whatever runs inside")
    for agent, (participants, endpoints) in found.local.items():
        shown = f"shows {found.shown[agent]} outside"
        yield f"  inside {agent}", str(participants), str(endpoints), "", "", "", shown


def _announcements(label: str, found: Announcements, growth: str) -> tuple[str, ...]:
    counts = (found.participants, found.endpoints, found.pairs, found.announced)
    return label, *map(str, counts), _bytes(found.estimated_bytes), growth


def _loads(rows: Sequence[AgentLoad]) -> Iterator[tuple[str, ...]]:
    yield (
        "agent",
        "transforms out",
        "in",
        "tf out",
        "in",
        "topics out",
        "in",
        "without rate or size",
    )
    for row in rows:
        rates = (f"{row.tf_out_hz:.4g}/s", f"{row.tf_in_hz:.4g}/s")
        bits = (row.tf_out_bps, row.tf_in_bps, row.topics_out_bps, row.topics_in_bps)
        yield row.agent, *rates, *(f"{b / 1e6:.3g} Mbit/s" for b in bits), _listed(row.unsized)


def _bytes(count: int) -> str:
    for unit, size in (("MB", 1_000_000), ("kB", 1000)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count} B"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "-"
