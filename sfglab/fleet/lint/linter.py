"""Fleet linter: all checks of one fleet, and the checks of services and actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.documents import DocumentError
from sfglab.fleet.fleet_file import Fleet, load_fleet
from sfglab.fleet.lint.discovery import discovery
from sfglab.fleet.lint.frames import check_frames
from sfglab.fleet.lint.machines import check_hosts, check_interfaces, check_router_image
from sfglab.fleet.lint.names import (
    check_descriptions,
    check_domains,
    check_qos,
    check_schema,
    check_static_transforms,
    check_topics_cross,
    check_types,
)
from sfglab.fleet.lint.report import Finding, Report, Severity, a_warning, an_error, render
from sfglab.fleet.lint.uses import Meeting, View
from sfglab.fleet.policy import Crossing, Direction
from sfglab.names import ResourceKind, dds_names, router_hazards

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


def check_rule_pairs(view: View) -> Iterator[Finding]:
    """Find rules that forward one endpoint of services without the other, or only in one direction."""
    other = {"rq/": "rr/", "rr/": "rq/"}
    rules = view.fleet.policy.rules
    places = view.fleet.rule_places or (view.fleet.place,) * len(rules)
    for rule, place in zip(rules, places, strict=True):
        half = rule.pattern[:3]
        if half not in other:
            continue
        mirror = other[half] + rule.pattern[3:]
        mirrored: set[Direction] = set()
        for candidate in rules:
            if candidate.pattern == mirror:
                mirrored |= candidate.directions
        if mirrored == rule.directions == set(Direction):
            continue
        yield an_error(
            "half-open-rule",
            place,
            what=f"rule {rule.pattern} opens one half of services; {mirror} is not open in the same "
            "directions",
            why="a call needs its request and its reply, each out at one router and in at the other; "
            "without them no agent can query another one's get_metadata",
            remedy=f"have both {rule.pattern} and {mirror}, in both directions, or neither",
        )


def check_servers(view: View) -> Iterator[Finding]:
    """Find clients that reach no server, and names that several agents serve."""
    for (kind, name), meeting in view.meetings.items():
        if kind is ResourceKind.TOPIC:
            continue
        crossing = view.crossing(name, kind)
        # Names that only the file implies are not reported here, because the rule itself is reported.
        if crossing is Crossing.PARTIAL and not meeting.implied:
            yield _half_open(view, kind, name, meeting)
        yield from _without_server(kind, name, meeting, crossing)
        if len(_servers(meeting)) > 1 and crossing is Crossing.WHOLE:
            yield an_error(
                "two-servers",
                meeting.speakers[-1].place,
                what=f"{', '.join(_servers(meeting))} all serve {kind.value} {name}, which crosses",
                why="each call reaches all of them; the client takes the first reply",
                remedy="put the agent into the name, /global/<agent>/...",
            )


def _half_open(view: View, kind: ResourceKind, name: str, meeting: Meeting) -> Finding:
    topics = dds_names(name, kind)
    policy = view.fleet.policy
    crossing = [t for t in topics if all(policy.crosses(t, way) for way in Direction)]
    blocked = [topic for topic in topics if topic not in crossing]
    return an_error(
        "half-open",
        meeting.first.place,
        what=f"{kind.value} {name} is half open: {len(crossing)} of its {len(topics)} DDS topics cross",
        why=f"clients of other agents wait indefinitely: {blocked[0]} does not cross both ways",
        remedy="allow requests and replies (rq/ and rr/) with the same pattern; an action needs rt/ too",
    )


def _without_server(
    kind: ResourceKind, name: str, meeting: Meeting, crossing: Crossing
) -> Iterator[Finding]:
    servers = _servers(meeting)
    for use in meeting.hearers:
        if use.agent in servers or (servers and crossing is not Crossing.NONE):
            continue
        if servers:
            yield an_error(
                "does-not-cross",
                use.place,
                what=f"{use.agent} calls {kind.value} {name} of {', '.join(servers)}, and reaches nothing",
                why="no forwarding rule lets it cross (paper A, Table 1)",
                remedy="serve it below /global/<agent>/",
            )
            continue
        finding = a_warning if use.implied else an_error
        yield finding(
            "no-server",
            use.place,
            what=f"{use.agent} calls {kind.value} {name}, which no agent in this file serves",
            why="its clients wait indefinitely",
            remedy="add the server to the file, or correct the name",
        )


def check_hazards(view: View) -> Iterator[Finding]:
    """Find forwarded services and actions whose names make a DDS Router confuse request and reply."""
    for (kind, name), meeting in view.meetings.items():
        hazards = router_hazards(name, kind)
        if hazards and view.crossing(name, kind) is not Crossing.NONE:
            broken = ", ".join(map(repr, hazards))
            yield an_error(
                "router-hazard",
                meeting.first.place,
                what=f"{kind.value} {name}: a DDS Router breaks {broken}",
                why="it finds the reply by replacing every 'rq/' by 'rr/' and every 'Request' by 'Reply'",
                remedy="rename so that no part ends in rq or rr before a slash or contains Request or Reply",
            )


def _servers(meeting: Meeting) -> tuple[str, ...]:
    return tuple(dict.fromkeys(use.agent for use in meeting.speakers))


CHECKS: tuple[Callable[[View], Iterator[Finding]], ...] = (
    check_domains,
    check_rule_pairs,
    check_topics_cross,
    check_servers,
    check_hazards,
    check_schema,
    check_descriptions,
    check_types,
    check_qos,
    check_static_transforms,
    check_frames,
    check_hosts,
    check_interfaces,
    check_router_image,
)
"""All checks. Findings of equal severity and line are listed in this order."""


def lint(fleet: Fleet) -> Report:
    """Check a fleet without running anything."""
    view = View(fleet)
    order = list(Severity)
    findings = [finding for check in CHECKS for finding in check(view)]
    findings.sort(key=lambda finding: (order.index(finding.severity), finding.place.line))
    return Report(
        fleet=fleet.name,
        findings=tuple(findings),
        hearings=view.hearings(),
        discovery=discovery(view),
    )


def lint_file(path: Path | str) -> tuple[str, int]:
    """Return the report on a fleet file and an exit code: 0, 1 with errors, 2 if it is no fleet file."""
    try:
        report = lint(load_fleet(path))
    except DocumentError as error:
        return f"error: {error}\n", 2
    return render(report), report.exit_code
