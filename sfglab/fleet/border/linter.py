"""The border linter: every check over one fleet, put together."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.documents import DocumentError
from sfglab.fleet.border.frames import check_frames
from sfglab.fleet.border.load import discovery, loads
from sfglab.fleet.border.matching import check_qos, check_static_transforms, check_types
from sfglab.fleet.border.names import (
    check_agents_named,
    check_descriptions,
    check_domains,
    check_publishers,
    check_schema,
    check_topics_cross,
)
from sfglab.fleet.border.render import render
from sfglab.fleet.border.report import Report, Severity
from sfglab.fleet.border.services import check_hazards, check_rule_pairs, check_servers
from sfglab.fleet.border.uses import View
from sfglab.fleet.fleet_file import load_fleet

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from sfglab.fleet.border.report import Finding
    from sfglab.fleet.fleet_file import Fleet


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
    """Check a fleet without running anything.

    Args:
        fleet: The fleet.
    """
    view = View(fleet)
    order = list(Severity)
    findings = [finding for check in CHECKS for finding in check(view)]
    findings.sort(key=lambda finding: (order.index(finding.severity), finding.place.line))
    return Report(
        fleet=fleet.name,
        findings=tuple(findings),
        hearings=view.hearings(),
        discovery=discovery(view),
        loads=loads(view),
    )


def lint_file(path: Path | str) -> tuple[str, int]:
    """Check a fleet file.

    Args:
        path: The file.

    Returns:
        The report as text, and an exit code: 0, 1 if there are errors, 2 if the file is not a fleet.
    """
    try:
        report = lint(load_fleet(path))
    except DocumentError as error:
        return f"error: {error}\n", 2
    return render(report), report.exit_code
