"""Fleet linter: predicts what a fleet's routers will forward, before anything runs."""

from sfglab.fleet.lint.linter import CHECKS, lint, lint_file
from sfglab.fleet.lint.report import Finding, Severity, render, render_findings
from sfglab.fleet.lint.uses import Meeting, Use, View

__all__ = [
    "CHECKS",
    "Finding",
    "Meeting",
    "Severity",
    "Use",
    "View",
    "lint",
    "lint_file",
    "render",
    "render_findings",
]
