"""Fleet linter: all checks of one fleet."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.documents import DocumentError
from sfglab.fleet.fleet_file import Fleet, load_fleet
from sfglab.fleet.lint.agents import (
    check_descriptions,
    check_domains,
    check_hosts,
    check_interfaces,
    check_router_image,
)
from sfglab.fleet.lint.discovery import discovery
from sfglab.fleet.lint.frames import check_frames
from sfglab.fleet.lint.names import (
    check_matches,
    check_reach,
    check_rule_pairs,
    check_schema,
    check_services,
    check_static_transforms,
)
from sfglab.fleet.lint.report import Finding, Report, Severity, render
from sfglab.fleet.lint.uses import View

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

CHECKS: tuple[Callable[[View], Iterator[Finding]], ...] = (
    check_domains,
    check_rule_pairs,
    check_reach,
    check_services,
    check_schema,
    check_descriptions,
    check_matches,
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
        agents=tuple(agent.name for agent in fleet.agents),
        discovery=None if fleet.zenoh else discovery(view),
    )


def lint_file(path: Path | str) -> tuple[str, int]:
    """Return the report on a fleet file and an exit code: 0, 1 with errors, 2 if it is no fleet file."""
    try:
        report = lint(load_fleet(path))
    except DocumentError as error:
        return f"error: {error}\n", 2
    return render(report), report.exit_code
