"""Schema lint: every check over one fleet, put together; those of services and actions stand here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.documents import DocumentError
from sfglab.fleet.fleet_file import Fleet, load_fleet
from sfglab.fleet.lint.frames import check_frames
from sfglab.fleet.lint.load import discovery, loads
from sfglab.fleet.lint.names import (
    check_agents_named,
    check_descriptions,
    check_domains,
    check_publishers,
    check_qos,
    check_schema,
    check_static_transforms,
    check_topics_cross,
    check_types,
)
from sfglab.fleet.lint.report import Finding, Report, Severity, an_error, render
from sfglab.fleet.lint.uses import Meeting, View
from sfglab.fleet.policy import Crossing, Direction
from sfglab.names import ResourceKind, dds_names, router_hazards

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


def check_rule_pairs(view: View) -> Iterator[Finding]:
    """Find rules that let one half of services pass and not the other, or only one way."""
    other = {"rq/": "rr/", "rr/": "rq/"}
    rules = view.fleet.policy.rules
    for position, rule in enumerate(rules):
        half = rule.pattern[:3]
        if half not in other:
            continue
        mirror = other[half] + rule.pattern[3:]
        ways = [r.directions for r in rules if r.pattern == mirror]
        open_ways = frozenset[Direction]().union(*ways)
        if open_ways == rule.directions == frozenset(Direction):
            continue
        what = f"rule {rule.pattern} lets one half of services pass; {mirror} is not open in the same ways"
        why = (
            "a call needs its request and its reply across, each out at one router and in at the other; "
            "without them no agent learns what another is (get_metadata)"
        )
        remedy = f"have both {rule.pattern} and {mirror}, in both directions, or neither"
        place = (view.fleet.rule_places or (view.fleet.place,) * len(rules))[position]
        yield an_error(code="half-open-rule", place=place, what=what, why=why, remedy=remedy)


def check_servers(view: View) -> Iterator[Finding]:
    """Find callers without a server they can reach, and servers that answer the same name twice."""
    for (kind, name), meeting in view.meetings.items():
        if kind is ResourceKind.TOPIC:
            continue
        crossing = view.crossing(name, kind)
        if (
            crossing is Crossing.HALF and not meeting.implied
        ):  # of those that are, the rule itself is reported
            yield _half_open(view, kind, name, meeting)
        yield from _unreachable(kind, name, meeting, crossing)
        if len({use.agent for use in meeting.speakers}) > 1 and crossing is Crossing.WHOLE:
            what = f"{_agents(meeting)} all serve {kind.value} {name}, which crosses"
            why = "each call reaches all of them; the caller takes whichever reply is first"
            remedy = "put the agent into the name, /global/<agent>/..."
            place = meeting.speakers[-1].place
            yield an_error(code="two-servers", place=place, what=what, why=why, remedy=remedy)


def _half_open(view: View, kind: ResourceKind, name: str, meeting: Meeting) -> Finding:
    halves = dds_names(name, kind)
    policy = view.fleet.policy
    passing = [dds for dds in halves if all(policy.crosses(dds, way) for way in Direction)]
    stuck = [dds for dds in halves if dds not in passing]
    what = f"{kind.value} {name} is half open: {len(passing)} of its {len(halves)} DDS topics cross"
    why = f"callers on other agents wait for ever: {stuck[0]} does not cross both ways"
    remedy = "allow requests and replies (rq/ and rr/) with the same pattern; an action needs rt/ as well"
    return an_error(code="half-open", place=meeting.first.place, what=what, why=why, remedy=remedy)


def _unreachable(
    kind: ResourceKind, name: str, meeting: Meeting, crossing: Crossing
) -> Iterator[Finding]:
    servers = {use.agent for use in meeting.speakers}
    for use in meeting.hearers:
        if use.agent in servers or (servers and crossing is not Crossing.NONE):
            continue
        what = f"{use.agent} calls {kind.value} {name}"
        if servers:
            severity, code = Severity.ERROR, "does-not-cross"
            what += f", which {_agents(meeting)} serves, and never reaches it"
            why = "no forwarding rule lets it cross (paper A, Table 1)"
            remedy = "serve it below /global/<agent>/"
        else:
            severity, code = Severity.WARNING if use.implied else Severity.ERROR, "no-server"
            what += ", which nobody in this file serves"
            why, remedy = (
                "its callers wait for ever",
                "add the server to the file, or correct the name",
            )
        yield Finding(
            severity=severity, code=code, place=use.place, what=what, why=why, remedy=remedy
        )


def check_hazards(view: View) -> Iterator[Finding]:
    """Find crossing services and actions whose names make a DDS Router confuse request and reply."""
    for (kind, name), meeting in view.meetings.items():
        hazards = router_hazards(name, kind)
        if hazards and view.crossing(name, kind) is not Crossing.NONE:
            what = f"{kind.value} {name}: a DDS Router breaks {', '.join(map(repr, hazards))}"
            why = "it finds the reply by replacing every 'rq/' by 'rr/' and every 'Request' by 'Reply'"
            remedy = "rename so that no part ends in rq or rr before a slash or contains Request or Reply"
            yield an_error(
                code="router-hazard", place=meeting.first.place, what=what, why=why, remedy=remedy
            )


def _agents(meeting: Meeting) -> str:
    return ", ".join(dict.fromkeys(use.agent for use in meeting.speakers))


CHECKS: tuple[Callable[[View], Iterator[Finding]], ...] = (
    check_domains,
    check_rule_pairs,
    check_topics_cross,
    check_servers,
    check_hazards,
    check_schema,
    check_agents_named,
    check_descriptions,
    check_publishers,
    check_types,
    check_qos,
    check_static_transforms,
    check_frames,
)
"""Every check, in the order in which findings of one severity and line are listed."""


def lint(fleet: Fleet) -> Report:
    """Check a fleet without running anything."""
    view = View(fleet)
    order = list(Severity)
    found = [finding for check in CHECKS for finding in check(view)]
    found.sort(key=lambda finding: (order.index(finding.severity), finding.place.line))
    hearings, costs = view.hearings(), discovery(view)
    return Report(
        fleet=fleet.name,
        findings=tuple(found),
        hearings=hearings,
        discovery=costs,
        loads=loads(view),
    )


def lint_file(path: Path | str) -> tuple[str, int]:
    """Return the report on a fleet file and an exit code: 0, 1 with errors, 2 if it is no fleet."""
    try:
        report = lint(load_fleet(path))
    except DocumentError as error:
        return f"error: {error}\n", 2
    return render(report), report.exit_code
