"""Fleets as tests deploy them: the paper's, the lab's and others; programs, files and values for the tests."""

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.deploy.deployment import Release, deployment_of
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

LAB = load_fleet(PROJECT / "data" / "fleets" / "lab.yaml")


def fleet_with(name="go2", *, host=None, agent=None, **common):
    """Return the fleet with other values of an agent's machine, of the agent, or common to all machines."""
    spec = FLEET.agent(name)
    changes = {"host": replace(spec.host, **(host or {}))} | (agent or {})
    agents = tuple(replace(one, **changes) if one is spec else one for one in FLEET.agents)
    return replace(FLEET, agents=agents, deployment=replace(FLEET.deployment, **common))


def deployed(name="go2", **changes):
    """Return an agent's deployment in such a fleet."""
    return deployment_of(fleet_with(name, **changes), name, RELEASE)


def over_zenoh(deployment, **address):
    """Return a deployment in a fleet that meets at a hub over Zenoh."""
    zenoh = ZenohAddress(hubs=("10.0.0.1",), **address)
    return replace(deployment, fleet=replace(deployment.fleet, zenoh=zenoh))


GO2 = deployed()


def rule(pattern, *ways):
    return ForwardRule(pattern=pattern, directions=frozenset(ways or Direction))


def fleet_of(*rules):
    """Return a fleet of one agent with a policy of its own."""
    return Fleet(name="f", policy=Policy(rules=rules), agents=(AgentSpec(name="go2", domain=7),))


def program(path, text="exit 0"):
    """Write a program of the shell."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/bash\n{text}\n", encoding="utf-8")
    path.chmod(0o755)
    return path


def needs(linter):
    """Mark a test that needs a program beside Python or on the path."""
    found = shutil.which(linter, path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    return pytest.mark.skipif(found is None, reason=f"{linter} is not installed")
