"""Report of the linter as values and as text: findings, receivers by name, and traffic of discovery."""

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
    """Severity of a finding, the worst first."""

    ERROR = "error"  #: The fleet relies on something that will not work.
    WARNING = "warning"  #: The fleet works, but probably not as intended, or not indefinitely.
    INFO = "info"  #: Information.


@dataclass(frozen=True, slots=True)
class Finding:
    """One error, warning or information about a fleet."""

    severity: Severity  #: Severity of the finding.
    code: str  #: Kind of the finding, a short stable name.
    place: Place  #: Place of the problem in the fleet file.
    what: str  #: Description of the problem.
    why: str  #: Consequence of the problem, and the rule that it follows from.
    remedy: str = ""  #: Solution; empty if none is needed.


# Function with which a check makes a finding.
an_error = partial(Finding, Severity.ERROR)
a_warning = partial(Finding, Severity.WARNING)
a_remark = partial(Finding, Severity.INFO)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hearing:
    """Agents that use one name, and whether it is forwarded between them."""

    name: str  #: ROS name.
    kind: ResourceKind  #: Topic, service or action.
    speakers: tuple[str, ...]  #: Agents that publish or serve the name.
    hearers: tuple[str, ...]  #: Agents that subscribe to or call the name.
    crosses: bool  #: Whether the name is forwarded from one agent to another.
    rules: tuple[str, ...]  #: Patterns of the rules that forward the name.


@dataclass(frozen=True, slots=True, kw_only=True)
class Announcements:
    """Traffic of discovery between the hosts of a fleet."""

    participants: int  #: Number of participants in the domain that the hosts share.
    endpoints: int  #: Number of endpoints in that domain.
    #: Number of ordered pairs of participants on different hosts: each announces itself to the other.
    pairs: int
    announced: int  #: Number of announcements of an endpoint to a participant on another host.
    estimated_bytes: int  #: Estimated bytes that all hosts receive for participants and endpoints.


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovery:
    """Discovery with one domain for all agents, and through routers."""

    standard: Announcements  #: Traffic if all processes of all agents share one domain.
    #: Traffic if only the routers share a domain, in which they announce what other agents need.
    routed: Announcements
    #: Numbers of participants and endpoints in each agent's own domain, by agent.
    local: dict[str, tuple[int, int]]
    #: Number of endpoints that each agent's router has in the global domain, by agent.
    shown: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Complete report on a fleet."""

    fleet: str  #: Name of the fleet.
    findings: tuple[Finding, ...]  #: Findings, the worst first, then in the order of the file.
    hearings: tuple[Hearing, ...]  #: Senders and receivers by name.
    agents: tuple[str, ...]  #: Names of all agents.
    #: Traffic of discovery over DDS; None if the agents meet over Zenoh.
    discovery: Discovery | None

    def count(self, severity: Severity) -> int:
        """Return the number of findings of a severity."""
        return sum(f.severity is severity for f in self.findings)

    @property
    def exit_code(self) -> int:
        """Exit code: 1 if there is an error, else 0."""
        return 1 if self.count(Severity.ERROR) else 0


def render(report: Report) -> str:
    """Return a report as text: findings, receivers by name, and over DDS traffic of discovery."""
    errors, warnings, infos = map(report.count, Severity)
    counts = f"{errors} error{_plural(errors)}, {warnings} warning{_plural(warnings)}, {infos} info"
    blocks = [
        f"fleet {report.fleet}",
        render_findings(report.findings),
        "senders and receivers\n" + text_table(_hearings(report)),
    ]
    if report.discovery:
        table = text_table(_discovery(report.discovery))
        blocks.append(f"discovery between hosts, estimated\n{table}")
    blocks.append(f"{report.fleet}: {counts}")
    return "\n\n".join(blocks) + "\n"


def _plural(count: int) -> str:
    return "" if count == 1 else "s"


def render_findings(findings: Iterable[Finding]) -> str:
    """Return findings as text, one paragraph each."""
    return "\n".join(_finding(finding) for finding in findings) or "no findings"


def _finding(finding: Finding) -> str:
    head = f"{finding.severity.value}: {finding.place}: {finding.what} [{finding.code}]"
    lines = [head]
    for label, text in (("why: ", finding.why), ("remedy: ", finding.remedy)):
        first, indent = f"    {label}", " " * (4 + len(label))
        lines += textwrap.wrap(text, WIDTH, initial_indent=first, subsequent_indent=indent)
    return "\n".join(lines)


def _hearings(report: Report) -> Iterator[tuple[str, ...]]:
    agents = set(report.agents)
    yield "name", "kind", "from", "to", "by rule"
    for row in report.hearings:
        hearers = _listed(row.hearers, agents)
        if row.hearers and set(row.hearers) == agents - set(row.speakers):
            hearers = "all others"
        rules = ", ".join(row.rules) if row.crosses else "does not cross"
        yield row.name, row.kind.value, _listed(row.speakers, agents), hearers, rules


def _listed(names: Sequence[str], agents: set[str]) -> str:
    return "all" if set(names) == agents else ", ".join(names) or "-"


def _discovery(found: Discovery) -> Iterator[tuple[str, ...]]:
    counts = ("participants", "endpoints", "pairs of participants", "announcements", "bytes")
    yield "", *counts, "grows with"
    yield _announcements("one domain for all", found.standard, "(processes in the fleet)^2")
    yield _announcements("through routers", found.routed, "agents x endpoints in the global domain")
    for agent, (participants, endpoints) in found.local.items():
        shown = f"{found.shown[agent]} in the global domain"
        yield f"  inside {agent}", str(participants), str(endpoints), "", "", "", shown


def _announcements(label: str, found: Announcements, growth: str) -> tuple[str, ...]:
    counts = (found.participants, found.endpoints, found.pairs, found.announced)
    return label, *map(str, counts), _bytes(found.estimated_bytes), growth


def _bytes(count: int) -> str:
    for unit, size in (("MB", 1_000_000), ("kB", 1000)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count} B"
