"""Fleets as tests deploy them: the paper's, the lab's and others; programs, files and values for the tests."""

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sfglab.deploy.deployment import Deployment, Release, deployment_of
from sfglab.fleet.fleet_file import AgentSpec, Fleet, load_fleet
from sfglab.fleet.policy import Direction, ForwardRule, Policy

PROJECT = Path(__file__).parents[2]
FILE = PROJECT / "data" / "fleets" / "esslingen.yaml"
FLEET = load_fleet(FILE)
LOCK = (PROJECT / "install/requirements.lock").read_text()
RELEASE = Release(
    version="1.2.3",
    wheel="sfglab-1.2.3-py3-none-any.whl",
    wheel_sha256="ab" * 32,
    lock=LOCK,
    fleet_text="fleet: esslingen\n",
    revision="c0ffee" * 6 + "c0ff",
    created="2026-01-02T03:04:05+00:00",
)

GO2 = deployment_of(FLEET, "go2", RELEASE)
LAB = load_fleet(PROJECT / "data" / "fleets" / "lab.yaml")


def deployed(agent: str = "go2", **common) -> Deployment:
    """Return an agent's deployment where something is another for all machines."""
    return deployment_of(
        replace(FLEET, deployment=replace(FLEET.deployment, **common)), agent, RELEASE
    )


def rule(pattern: str, *ways: Direction) -> ForwardRule:
    return ForwardRule(pattern=pattern, directions=frozenset(ways or Direction))


def fleet_of(*rules: ForwardRule) -> Fleet:
    """Return a fleet of one agent with a policy of its own."""
    return Fleet(name="f", policy=Policy(rules=rules), agents=(AgentSpec(name="go2", domain=7),))


def program(path: Path, text: str = "exit 0") -> Path:
    """Write a program of the shell."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/bash\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


def needs(linter: str):
    """Mark a test that needs a program beside Python or on the path."""
    found = shutil.which(linter, path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    return pytest.mark.skipif(found is None, reason=f"{linter} is not installed")
