"""Fleets as tests deploy them: the paper's and a release of it, the lab's, and one with rules of its own."""

from __future__ import annotations

from pathlib import Path

from sfglab.deploy.deployment import Release
from sfglab.fleet.fleet_file import AgentSpec, Fleet, load_fleet
from sfglab.fleet.lint import Severity
from sfglab.fleet.policy import Direction, ForwardRule, Policy

PROJECT = Path(__file__).parents[2]
FILE = PROJECT / "data" / "fleets" / "esslingen.yaml"
FLEET = load_fleet(FILE)
LOCK = (PROJECT / "requirements.lock").read_text()
RELEASE = Release(
    version="1.2.3",
    wheel="sfglab-1.2.3-py3-none-any.whl",
    wheel_sha256="ab" * 32,
    lock=LOCK,
    fleet_text="fleet: esslingen\n",
    revision="c0ffee" * 6 + "c0ff",
    created="2026-01-02T03:04:05+00:00",
)

LAB = load_fleet(PROJECT / "data" / "fleets" / "lab.yaml")


def rule(pattern: str, *ways: Direction) -> ForwardRule:
    return ForwardRule(pattern=pattern, description="", directions=frozenset(ways or Direction))


def fleet_of(*rules: ForwardRule) -> Fleet:
    """Return a fleet of one agent with a policy of its own."""
    return Fleet(name="f", policy=Policy(rules=rules), agents=(AgentSpec(name="go2", domain=7),))


def codes(findings, severity=Severity.ERROR):
    return {finding.code for finding in findings if finding.severity is severity}
