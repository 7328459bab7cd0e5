"""The linter's report as text for a terminal."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from sfglab.fleet.border.report import Severity
from sfglab.tables import WIDTH, text_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.fleet.border.report import AgentLoad, Announcements, Discovery, Finding, Report


def render(report: Report) -> str:
    """Return a report as text: findings, who hears what, discovery, and what crosses each border."""
    blocks = [
        f"fleet {report.fleet}",
        render_findings(report.findings),
        "who hears what\n" + text_table(_hearings(report)),
        "discovery between hosts, estimated\n" + text_table(_discovery(report.discovery)),
        "across each border, estimated\n" + text_table(_loads(report.loads)),
        _summary(report),
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
    return textwrap.wrap(text, WIDTH, initial_indent=f"    {label}", subsequent_indent=" " * (4 + len(label)))


def _hearings(report: Report) -> Iterator[tuple[str, ...]]:
    everybody = tuple(load.agent for load in report.loads)
    yield "name", "kind", "from", "to", "by rule"
    for row in report.hearings:
        rules = ", ".join(row.rules) if row.crosses else "does not cross"
        speakers, hearers = _crowd(row.speakers, everybody), _crowd(row.hearers, everybody)
        others = tuple(name for name in everybody if name not in row.speakers)
        yield (
            row.name,
            row.kind.value,
            speakers,
            "all others" if set(row.hearers) == set(others) else hearers,
            rules,
        )


def _crowd(names: Sequence[str], everybody: Sequence[str]) -> str:
    return "all" if set(names) == set(everybody) else _listed(names)


def _discovery(found: Discovery) -> Iterator[tuple[str, ...]]:
    yield "", "participants", "endpoints", "pairs of participants", "announcements", "bytes", "grows with"
    yield _announcements("one domain for all", found.standard, "(processes in the fleet)^2")
    yield _announcements("through routers", found.routed, "agents^2, whatever runs inside")
    for agent, (participants, endpoints) in found.local.items():
        shown = f"shows {found.shown[agent]} outside"
        yield f"  inside {agent}", str(participants), str(endpoints), "", "", "", shown


def _announcements(label: str, found: Announcements, growth: str) -> tuple[str, ...]:
    counts = (found.participants, found.endpoints, found.pairs, found.announced)
    return label, *map(str, counts), _bytes(found.estimated_bytes), growth


def _loads(rows: Sequence[AgentLoad]) -> Iterator[tuple[str, ...]]:
    yield "agent", "transforms out", "in", "tf out", "in", "topics out", "in", "without rate or size"
    for row in rows:
        rates = (f"{row.tf_out_hz:.4g}/s", f"{row.tf_in_hz:.4g}/s")
        bits = (row.tf_out_bps, row.tf_in_bps, row.topics_out_bps, row.topics_in_bps)
        yield row.agent, *rates, *(f"{b / 1e6:.3g} Mbit/s" for b in bits), _listed(row.unsized)


def _summary(report: Report) -> str:
    counts = ", ".join(f"{report.count(s)} {s.value}{'' if report.count(s) == 1 else 's'}" for s in Severity)
    return f"{report.fleet}: {counts}".replace("infos", "info")


def _bytes(count: int) -> str:
    for unit, size in (("MB", 1_000_000), ("kB", 1000)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count} B"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "-"
