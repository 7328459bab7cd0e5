"""Whether an agent's folder may go to a machine: a verdict of each check, also where it was not asked."""

from __future__ import annotations

from sfglab.deploy.checking.bundle import OwnRules, check_bundle, own_rules
from sfglab.deploy.checking.compose import check_compose
from sfglab.deploy.checking.dockerfile import check_dockerfiles
from sfglab.deploy.checking.leaks import check_secrets
from sfglab.deploy.checking.programs import MissingProgramError, find_program, run_program
from sfglab.deploy.checking.shell import check_shell
from sfglab.deploy.checking.verdicts import (
    SkippedError,
    State,
    Verdict,
    render_verdicts,
    verdict_of,
)

__all__ = [
    "MissingProgramError",
    "OwnRules",
    "SkippedError",
    "State",
    "Verdict",
    "check_bundle",
    "check_compose",
    "check_dockerfiles",
    "check_secrets",
    "check_shell",
    "find_program",
    "own_rules",
    "render_verdicts",
    "run_program",
    "verdict_of",
]
